"""A colour limit that is dragged in a pane is the display's setting, everywhere."""

from __future__ import annotations

import pytest

from app.frame.tour import wait_until_shown


def test_a_dragged_limit_is_the_panels_and_every_panes(bubble_window, qtbot):
    window = bubble_window.window
    before = window.columns["depth"].view.picture
    window.columns["depth"].view.levels.limit_dragged.emit("bubble_limit_mm", 4.237)
    window.columns["depth"].view.levels.limit_dragged.emit("bubble_floor_mm", 1.0)
    assert wait_until_shown(bubble_window, 60)
    assert bubble_window.session.display.bubble_limit_mm == pytest.approx(4.24)
    scale = window.columns["depth"].view.picture.scale
    assert (scale.low, scale.high) == (1.0, pytest.approx(4.24))
    assert before.scale.high != scale.high
    bubble_window.undo.undo()
    assert bubble_window.session.display.bubble_limit_mm == 10.0


def test_a_limit_goes_no_farther_than_its_setting_and_never_past_the_other(bubble_window):
    levels = bubble_window.window.columns["depth"].view.levels
    levels.limit_dragged.emit("bubble_limit_mm", 1e6)
    assert bubble_window.session.display.bubble_limit_mm == 25.0
    levels.limit_dragged.emit("bubble_limit_mm", -3.0)
    levels.limit_dragged.emit("bubble_floor_mm", 20.0)
    assert wait_until_shown(bubble_window, 60)
    scale = bubble_window.window.columns["depth"].view.picture.scale
    assert scale.low < scale.high
