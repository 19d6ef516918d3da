"""The Timings tab: shares of a frame's time, and a click that skips a stage."""

from __future__ import annotations

from dataclasses import replace

import pytest
from PyQt6.QtCore import Qt

from app.window.time_budget import TimeBudgetController
from app.window.tour import wait_until_shown

LIMIT_S = 240
TIMES_MS = {"depth": 60.0, "cloud": 2.0, "target_depth": 8.0, "touch": 100.0, "touch_depth": 5.0}


@pytest.fixture
def timed_window(bubble_window):
    """The window with known times of the stages that its frame computes."""
    budget = next(child for child in bubble_window.children() if isinstance(child, TimeBudgetController))
    for name, ms in TIMES_MS.items():
        result = bubble_window.latest_frame.results[name]
        for _ in range(20):
            params = bubble_window.session.get_params(result.method)
            budget._clock.record(replace(result, ms=ms, state="computed"), params)
    return bubble_window


def _row(panel, title):
    return next(r for r in range(panel.table.rowCount()) if panel.table.item(r, 0).text() == title)


def test_a_click_skips_stages_to_reach_the_target_and_a_tick_brings_them_back(timed_window, qtbot):
    panel = timed_window.window.timings
    panel._target.setValue(2)
    assert panel.skip_button.isHidden()
    assert [part.time_ms for part in panel.bar.parts] == list(TIMES_MS.values())
    panel._target.setValue(14)
    assert panel.sentence.text().startswith(
        "generated touch 57 %, depth 34 %, target depth 5 %: 5.7 frames/s; without "
    )
    assert panel.sentence.text().endswith(" 14")
    qtbot.mouseClick(panel.skip_button, Qt.MouseButton.LeftButton)
    assert wait_until_shown(timed_window, LIMIT_S)
    assert timed_window.session.layout.skipped_stages == ("touch", "touch_depth", "pose")
    assert list(timed_window.latest_frame.results) == ["depth", "cloud", "target_depth"]
    assert not timed_window.window.columns["touch"].isVisible()
    row = _row(panel, "Generated touch")
    assert panel.table.item(row, 1).text() == "skipped"
    panel.table.item(row, 0).setCheckState(Qt.CheckState.Checked)
    assert wait_until_shown(timed_window, LIMIT_S)
    assert list(timed_window.latest_frame.results) == ["depth", "cloud", "target_depth", "touch"]
    timed_window.undo_stack.undo()
    timed_window.undo_stack.undo()
    assert wait_until_shown(timed_window, LIMIT_S)
    assert timed_window.latest_frame.results.keys() > TIMES_MS.keys()


def test_the_first_stage_stays_and_other_layouts_compute_all(bubble_window):
    panel = bubble_window.window.timings
    panel.table.item(0, 0).setCheckState(Qt.CheckState.Unchecked)  # with all that depend on it: nothing would remain
    assert not bubble_window.session.layout.skipped_stages
    assert panel.table.item(0, 0).checkState() == Qt.CheckState.Checked
    panel.table.item(_row(panel, "Generated touch"), 0).setCheckState(Qt.CheckState.Unchecked)
    assert wait_until_shown(bubble_window, LIMIT_S)
    assert "touch" not in bubble_window.window.visible_columns()
    bubble_window.window.actions_by_name["layout_demo"].trigger()
    assert wait_until_shown(bubble_window, LIMIT_S)
    assert "touch" in bubble_window.latest_frame.results
