"""The blame tab: takes the frame at hand apart, once somebody looks."""

from __future__ import annotations

import pytest
from PyQt6.QtCore import QPoint, Qt

from app.session.sample import SAMPLE_RECORDING
from app.shell.tour import wait_until_shown
from pipeline.translation.error_attribution import OUTSIDE_VIEW
from widgets.frames.error_attribution_panel import make_bars

LIMIT_MS = 240_000


@pytest.fixture
def window(open_window, qtbot):
    controller = open_window(
        SAMPLE_RECORDING, source="gelslim", target="soft_bubble", frame=5, route="t2d2"
    )
    assert wait_until_shown(controller, 240), controller.window.banner.text
    return controller


def test_the_error_of_the_current_frame_is_attributed(window, qtbot):
    panel = window.window.error_attribution
    qtbot.waitUntil(lambda: bool(panel.waterfall.bars), timeout=LIMIT_MS)
    assert OUTSIDE_VIEW in [bar.title for bar in panel.waterfall.bars]
    first, *parts, last = panel.waterfall.bars
    assert first.end + sum(bar.change for bar in parts) == pytest.approx(last.end)
    window.choose_frame(6)
    qtbot.waitUntil(lambda: not panel.waterfall.bars, timeout=LIMIT_MS)  # of another frame
    qtbot.waitUntil(lambda: bool(panel.waterfall.bars), timeout=LIMIT_MS)
    panel.metric_box.setCurrentIndex(panel.metric_box.findData("pose.mssd_mm"))
    assert "mm" in panel.metric_box.currentText()
    panel.metric_box.chosen.emit("pose.mssd_mm")
    qtbot.waitUntil(lambda: len(panel.waterfall.bars) == 7, timeout=LIMIT_MS)


def test_a_click_on_a_share_pins_the_truth_of_its_stage_in_the_column_head(window, qtbot):
    panel = window.window.error_attribution
    columns = window.window.columns
    qtbot.waitUntil(lambda: bool(panel.waterfall.bars), timeout=LIMIT_MS)
    row = next(k for k, bar in enumerate(panel.waterfall.bars) if bar.title == "depth")
    tall = panel.waterfall.sizeHint().height() / len(panel.waterfall.bars)
    qtbot.mouseClick(
        panel.waterfall, Qt.MouseButton.LeftButton, pos=QPoint(50, round((row + 0.5) * tall))
    )
    assert wait_until_shown(window, 240)
    assert window.session.methods == {"depth": "truth"}
    assert columns["depth"]._method.currentText() == "Truth"
    assert columns["depth"].state == "warning"
    assert window.latest_frame.metrics["depth.mae_mm"] == 0.0
    columns["depth"].method_chosen.emit("depth", "network")  # released in the head
    assert wait_until_shown(window, 240)
    assert not window.session.methods
    assert window.latest_frame.metrics["depth.mae_mm"] > 0.0


def test_truth_is_offered_only_where_the_recording_holds_it(bubble_window, window):
    for controller, known in ((bubble_window, False), (window, True)):
        for stage in ("depth", "touch_depth", "pose"):
            box = controller.window.columns[stage]._method
            assert box.model().item(box.findData("truth")).isEnabled() == known


def test_a_frame_without_truth_has_no_attribution(bubble_window, qtbot):
    panel = bubble_window.window.error_attribution
    qtbot.waitUntil(lambda: "no touch of the target" in panel.sentence.text(), timeout=LIMIT_MS)
    assert panel.metric_box.isHidden()


def test_each_bar_begins_where_the_one_before_it_ended():
    shown = make_bars("error", 1.0, (("depth", 0.3), ("drawing", -0.1)), 0.8)
    assert [(round(b.begin, 3), round(b.end, 3)) for b in shown] == [
        (0.0, 1.0),
        (1.0, 0.7),
        (0.7, 0.8),
        (0.0, 0.8),
    ]
