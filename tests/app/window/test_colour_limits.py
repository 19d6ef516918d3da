"""A colour limit that is dragged in a pane is the display's setting, everywhere."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PyQt6.QtCore import Qt

from app.session.sample import SAMPLE_RECORDING
from app.session.state import DISPLAY_KEY
from app.shell.tour import wait_until_shown
from pipeline.views.display_params import DisplayParams
from pipeline.views.preview import DEVIATION_LABEL


def test_a_dragged_limit_applies_to_panel_and_panes(bubble_window, qtbot):
    window = bubble_window.window
    before = window.columns["depth"].view.preview
    fitted_mm = bubble_window.session.display.bubble_limit_mm
    window.columns["depth"].view.colour_bar.limit_dragged.emit("bubble_limit_mm", 4.237)
    window.columns["depth"].view.colour_bar.limit_dragged.emit("bubble_floor_mm", 1.0)
    assert wait_until_shown(bubble_window, 60)
    assert bubble_window.session.display.bubble_limit_mm == pytest.approx(4.24)
    scale = window.columns["depth"].view.preview.scale
    assert (scale.low, scale.high) == (1.0, pytest.approx(4.24))
    assert before.scale.high != scale.high
    bubble_window.undo_stack.undo()
    assert bubble_window.session.display.bubble_limit_mm == fitted_mm == 8.0


def test_limits_are_fitted_once_to_a_recording(open_window):
    sample_window = open_window(SAMPLE_RECORDING, source="gelslim", target="soft_bubble", frame=5)
    assert wait_until_shown(sample_window, 240), sample_window.window.banner.text
    display = sample_window.session.display
    limits = {
        name: column.view.preview.scale
        for name, column in sample_window.window.columns.items()
        if column.view.preview.scale is not None
    }
    assert (limits["touch"].low, limits["touch"].high) == (-5.0, 5.0)
    for frame in (3, 9):
        sample_window.choose_frame(frame)
        assert wait_until_shown(sample_window, 60)
        assert sample_window.session.display == display
        for name, scale in limits.items():
            assert sample_window.window.columns[name].view.preview.scale == scale
    following = sample_window.session.with_updates(recording=Path("other.h5"))
    assert following.display == display.without_limits()


def test_a_limit_stays_in_range_and_does_not_pass_the_other(bubble_window):
    levels = bubble_window.window.columns["depth"].view.colour_bar
    levels.limit_dragged.emit("bubble_limit_mm", 1e6)
    assert bubble_window.session.display.bubble_limit_mm == 25.0
    levels.limit_dragged.emit("bubble_limit_mm", -3.0)
    levels.limit_dragged.emit("bubble_floor_mm", 20.0)
    assert wait_until_shown(bubble_window, 60)
    scale = bubble_window.window.columns["depth"].view.preview.scale
    assert scale.low < scale.high


def test_a_double_click_fits_the_limits_in_one_undo_step(bubble_window, qtbot):
    columns = bubble_window.window.columns
    source = columns["source"].view
    bubble_window.choose_params(DISPLAY_KEY, DisplayParams(bubble_quantity="distance"))
    assert wait_until_shown(bubble_window, 60)
    built = source.preview.scale
    assert (built.low_setting, built.high_setting) == ("bubble_near_mm", "bubble_far_mm")
    qtbot.mouseDClick(source.colour_bar, Qt.MouseButton.LeftButton)
    assert wait_until_shown(bubble_window, 60)
    fitted = source.preview.scale
    values = source.preview.values
    inside = values[np.isfinite(values)]
    np.testing.assert_allclose(
        (fitted.low, fitted.high), np.percentile(inside, (1, 99)), atol=0.006
    )
    bubble_window.choose_frame(1)  # the limits are absolute: another frame keeps them
    assert wait_until_shown(bubble_window, 60)
    assert source.preview.scale == fitted
    bubble_window.undo_stack.undo()
    bubble_window.undo_stack.undo()
    assert wait_until_shown(bubble_window, 60)
    assert source.preview.scale == built


def test_bubble_deviation_uses_the_indentation_limit_in_both_directions(bubble_window):
    columns = bubble_window.window.columns
    assert columns["source"].view.preview.scale.quantity == DEVIATION_LABEL
    columns["source"].view.colour_bar.limit_dragged.emit("bubble_limit_mm", 6.0)
    assert wait_until_shown(bubble_window, 60)
    scale, depth = (columns[name].view.preview.scale for name in ("source", "depth"))
    assert (scale.low, scale.high, depth.high) == (-6.0, 6.0, 6.0)
    bubble_window.probe.probe_pixel("source", 70, 80)
    said = bubble_window.window.readout.text()
    assert "deviation from rest" in said
    assert "distance" in said


def test_the_pose_distance_has_its_own_limit(bubble_window):
    pose = bubble_window.window.columns["pose"].view
    before = _limits(pose)
    pose.colour_bar.limit_dragged.emit("residual_limit_mm", 0.123)
    assert wait_until_shown(bubble_window, 60)
    assert _limits(pose) == (-0.12, 0.12) != before


def test_a_pixel_outside_a_smaller_image_is_unpinned(bubble_window):
    controller = bubble_window
    controller.probe.toggle_pin("target_depth", 100, 400)
    assert controller.window.columns["target_depth"].view.canvas.crosshair == (100, 400)
    controller.change("another target", target="digit")  # 240 pixels wide
    assert wait_until_shown(controller, 240)
    assert controller.window.columns["target_depth"].view.canvas.crosshair is None
    assert "pinned" not in controller.window.trace.text


def _limits(view):
    scale = view.preview.scale
    assert (scale.low_setting, scale.high_setting) == ("residual_limit_mm", "residual_limit_mm")
    return scale.low, scale.high
