"""The registration step by step: kept where somebody asks, looked at in 2D, 3D, as curves and in words."""

from __future__ import annotations

import numpy as np
import pytest
from PyQt6.QtCore import Qt

from app.window.tour import wait_until_shown
from pipeline.previews.colours import UNMATCHED_POINT_COLOUR

LIMIT_S = 120


@pytest.fixture
def posed(open_window, touch_file, ball_file):
    """A window with a pose, no steps kept."""
    made = open_window(touch_file, target="gelslim", frame=2, mesh=ball_file, mesh_unit="mm")
    assert wait_until_shown(made, LIMIT_S), made.window.banner.text
    return made


def test_the_steps_are_asked_for_and_each_of_them_is_shown_everywhere(posed, qtbot):
    window, tab = posed.window, posed.window.steps_panel
    slider, view = window.steps["pose"], window.columns["pose"].view
    before = posed.views.get_shown_stage("pose")
    assert (before.states, before.way) == ((), None), "nothing is worked out that nobody asked for"
    assert slider.keep.isVisibleTo(window)
    slider.keep.click()
    assert wait_until_shown(posed, LIMIT_S)
    part = posed.views.get_shown_stage("pose")
    assert part.result.digest == before.result.digest, "the answer is the same"
    n = len(part.result.output.steps)
    assert n == len(part.states) == len(part.state_layers) == tab.plot.count > 3
    assert "converged: " in tab.message
    assert window.tabs.currentWidget() is tab
    assert tab.slot == "pose"
    drawn = []
    posed.views.scene.show_layers = lambda _, layers: drawn.append(layers)
    tab.plot.setFocus()
    qtbot.keyClick(tab.plot, Qt.Key.Key_Home)
    assert slider.slider.value() == tab.plot.at == 0
    assert tab.step.startswith(f"step 1 of {n}: rms ")
    assert view.picture is part.states[0]
    assert not np.array_equal(view.picture.pixels, part.states[-1].pixels)
    (layers,) = drawn
    lines = next(layer for layer in layers if layer.segments is not None)
    assert len(lines.segments) == len(lines.points_mm) // 2 > 10
    slider.slider.setValue(1)
    assert tab.plot.at == 1
    assert not (lines.rgb == UNMATCHED_POINT_COLOUR).all()
    tab.keep.click()  # they are let go, and that is undone like any setting
    assert wait_until_shown(posed, LIMIT_S)
    assert not tab.plot.count
    posed.undo_stack.undo()
    assert wait_until_shown(posed, LIMIT_S)
    assert tab.plot.count
