"""Up to five pinned pixels: marks in every preview, a table of values and errors, released one
by one.
"""

from __future__ import annotations

import pytest
from PyQt6.QtCore import Qt
from PyQt6.QtTest import QTest

from app.session.sample import SAMPLE_RECORDING
from app.shell.tour import wait_until_shown
from widgets.style.tables import format_table

LIMIT_S = 240
PIXELS = [(80, 110), (30, 50), (30, 110), (30, 170), (130, 110)]


def _cells(table, row):
    return {
        table.horizontalHeaderItem(c).text(): table.item(row, c).text()
        for c in range(table.columnCount())
    }


def _marks(window, column):
    return dict(window.columns[column].view.canvas.marks)


def test_five_pixels_are_marked_in_every_preview_and_follow_the_frames(bubble_window, qtbot):
    window = bubble_window.window
    probe = bubble_window.probe
    panel = bubble_window.window.probes
    window.show_diagnostics(panel)
    for row, col in PIXELS:
        probe.toggle_pin("depth", row, col)
    probe.toggle_pin("depth", 130, 40)  # a sixth
    assert "5 pixels are pinned" in window.said
    qtbot.waitUntil(lambda: panel.table.rowCount() == 5)
    assert wait_until_shown(bubble_window, LIMIT_S)
    assert _marks(window, "depth") == dict(enumerate(PIXELS, 1))
    assert _marks(window, "source") == _marks(window, "depth")
    assert _marks(window, "target_depth").keys() <= set(range(1, 6))
    before = _cells(panel.table, 0)
    assert before["source pixel"] == "(110, 80)"
    depth = bubble_window.latest_frame.results["depth"].output
    assert before["depth, mm"] == f"{depth.indentation_mm[PIXELS[0]]:.3f}"
    assert format_table(panel.table).splitlines()[1].split("\t")[:2] == ["1", "(110, 80)"]
    bubble_window.choose_frame(1)
    assert wait_until_shown(bubble_window, LIMIT_S)
    qtbot.waitUntil(lambda: _cells(panel.table, 0)["depth, mm"] != before["depth, mm"])
    canvas = window.columns["depth"].view.canvas
    # on mark 3: released
    probe.toggle_pin("depth", PIXELS[2][0], PIXELS[2][1] + round(3 / canvas.scale))
    assert list(probe.pins) == [1, 2, 4, 5]
    assert window.actions_by_name["pin_probe"].isChecked()  # the crosshair is at pin 5
    QTest.mouseClick(
        panel.table.viewport(),
        Qt.MouseButton.LeftButton,
        pos=panel.table.visualItemRect(panel.table.item(1, 0)).center(),
    )
    assert canvas.crosshair == PIXELS[1]
    probe.toggle_pin("depth", 130, 40)  # takes the free number
    assert probe.pins[3] == ("depth", 130, 40)
    window.actions_by_name["cancel"].trigger()
    assert not probe.pins
    qtbot.waitUntil(lambda: not _marks(window, "depth") and panel.table.rowCount() == 0)


@pytest.fixture
def sample_window(open_window):
    controller = open_window(SAMPLE_RECORDING, source="gelslim", target="soft_bubble", frame=5)
    assert wait_until_shown(controller, LIMIT_S), controller.window.banner.text
    return controller


def test_the_error_is_the_value_less_the_truth_and_is_read_only_when_it_is_seen(
    sample_window, qtbot
):
    window = sample_window.window
    probe = sample_window.probe
    panel = sample_window.window.probes
    depth = sample_window.latest_frame.results["depth"].output
    row, col = (
        int(v) for v in divmod(int(depth.indentation_mm.argmax()), depth.indentation_mm.shape[1])
    )
    probe.toggle_pin("depth", row, col)
    qtbot.waitUntil(lambda: 1 in _marks(window, "touch_depth"))
    assert sample_window.views.get_shown_stage("depth").truth_view is None  # the tab is closed
    window.show_diagnostics(panel)
    qtbot.waitUntil(lambda: panel.table.rowCount() == 1)
    assert wait_until_shown(sample_window, LIMIT_S)
    qtbot.waitUntil(lambda: panel.table.horizontalHeaderItem(4) is not None)

    qtbot.waitUntil(lambda: panel.table.horizontalHeaderItem(4).text() == "depth error, mm")
    truth = sample_window.views.translation.read_source_truth(5).indentation_mm[row, col]
    error_mm = float(panel.table.item(0, 4).text())
    assert error_mm == pytest.approx(depth.indentation_mm[row, col] - truth, abs=6e-4)
