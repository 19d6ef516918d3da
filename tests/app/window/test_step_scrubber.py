"""The registration step by step: kept where somebody asks, looked at in 2D, 3D, as curves and in
words.
"""

from __future__ import annotations

import numpy as np
import pytest
from PyQt6.QtCore import Qt

from app.shell.tour import wait_until_shown
from pipeline.views.colours import UNMATCHED_POINT_COLOUR

LIMIT_S = 240


@pytest.fixture
def posed(open_window, touch_file, ball_file):
    """A window with a pose, no steps kept."""
    made = open_window(touch_file, target="gelslim", frame=2, mesh=ball_file, mesh_unit="mm")
    assert wait_until_shown(made, LIMIT_S), made.window.banner.text
    return made


def test_steps_are_kept_on_request_and_shown_everywhere(posed, qtbot):
    window = posed.window
    window.actions_by_name["stage_7"].trigger()
    tab = posed.window.steps_panel
    view = window.columns["pose"].view
    before = posed.views.get_shown_stage("pose")
    assert (before.step_previews, before.step_history) == ((), None), (
        "nothing is worked out that nobody asked for"
    )
    window.actions_by_name["step_through"].trigger()
    assert wait_until_shown(posed, LIMIT_S)
    part = posed.views.get_shown_stage("pose")
    assert part.result.digest == before.result.digest, "the answer is the same"
    n = len(part.result.output.steps)
    assert n == len(part.step_previews) == len(part.step_layers) == tab.plot.n_steps > 3
    assert "converged: " in tab.message.text()
    assert window.tabs.currentWidget() is tab
    assert tab.stage_box.choice == "pose"
    drawn = []
    posed.views.scene.show_layers = lambda _, layers: drawn.append(layers)
    tab.plot.setFocus()
    qtbot.keyClick(tab.plot, Qt.Key.Key_Home)
    assert tab.plot.current_step == 0
    assert tab.step_text.text().startswith(f"step 1 of {n}: rms ")
    assert view.preview is part.step_previews[0]
    assert not np.array_equal(view.preview.pixels, part.step_previews[-1].pixels)
    (layers,) = drawn
    lines = next(layer for layer in layers if layer.segments is not None)
    assert len(lines.segments) == len(lines.points_mm) // 2 > 10
    qtbot.keyClick(tab.plot, Qt.Key.Key_Right)
    assert tab.plot.current_step == 1
    assert view.preview is part.step_previews[1]
    assert not (lines.rgb == UNMATCHED_POINT_COLOUR).all()
    tab.keep_button.click()  # they are let go, and that is undone like any setting
    assert wait_until_shown(posed, LIMIT_S)
    assert not tab.plot.n_steps
    posed.undo_stack.undo()
    assert wait_until_shown(posed, LIMIT_S)
    assert tab.plot.n_steps
