"""A bubble's depth is shown as distance from rest.

The distance from its camera stays in the values.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.core.values.frames import TactileFrame
from pipeline.sensors.spec import load_sensor
from pipeline.stages import ground_truth
from pipeline.stages.stage import GroundTruth
from pipeline.stages.touch.physical_render import make_reference_touch
from pipeline.views.difference import compute_difference
from pipeline.views.display_params import DisplayParams
from pipeline.views.image_views import TOUCH
from pipeline.views.preview import DEVIATION_LABEL, make_frame_preview
from pipeline.views.view import PreviewContext, ProbePoint

DISPLAY = DisplayParams()


@pytest.fixture(scope="module")
def bubble():
    return load_sensor("soft_bubble")


@pytest.fixture
def pressed(bubble):
    """3 mm in at one pixel, 1 mm out at another, no reading at a third."""
    depth = bubble.rest_depth_mm.astype(np.float32)
    depth[40, 50] -= 3.0
    depth[60, 70] += 1.0
    depth[5, 5] = np.nan
    return depth


def test_a_press_is_above_zero_and_what_bulges_below(bubble, pressed):
    shown = make_frame_preview(pressed, bubble.camera, bubble, DISPLAY)
    assert shown.scale.quantity == DEVIATION_LABEL
    assert (shown.scale.low, shown.scale.high, shown.scale.unit) == (-10.0, 10.0, "mm")
    np.testing.assert_allclose(shown.values[[40, 60, 0], [50, 70, 0]], (3.0, -1.0, 0.0), atol=1e-4)
    assert np.isnan(shown.values[5, 5])
    assert "no reference recorded" in shown.caption


def test_the_probe_tells_deviation_and_distance(bubble, pressed):
    said = make_frame_preview(pressed, bubble.camera, bubble, DISPLAY).describe_pixel(40, 50)
    assert "deviation from rest 3.000 mm" in said
    assert f"distance {pressed[40, 50]:.2f} mm" in said


def test_rest_is_what_the_very_unit_read_untouched(bubble, pressed):
    longer = bubble.rest_depth_mm.astype(np.float32) + 2.0
    shown = make_frame_preview(pressed, bubble.camera, bubble, DISPLAY, reference=longer)
    assert shown.values[40, 50] == pytest.approx(5.0, abs=1e-4)
    assert shown.caption == DEVIATION_LABEL


def test_distance_is_shown_where_it_is_chosen(bubble, pressed):
    shown = make_frame_preview(
        pressed, bubble.camera, bubble, DisplayParams(bubble_quantity="distance")
    )
    np.testing.assert_array_equal(shown.values, pressed)
    assert shown.distance_mm is None
    assert shown.scale.low > 0


def test_a_generated_bubble_and_its_truth_have_one_scale_and_a_difference(bubble, pressed):
    seen = PreviewContext(outputs={}, source=bubble, target=bubble, mesh=None, display=DISPLAY)
    unit = bubble.rest_depth_mm.astype(np.float32) + 2.0
    frame = TactileFrame(sensor="soft_bubble", image=pressed + np.float32(2.0), reference=unit)
    true = TOUCH.make_preview(
        ground_truth.build_touch(GroundTruth(target_observation=frame), bubble), seen
    )
    made = TOUCH.make_preview(replace(make_reference_touch(bubble), image=pressed), seen)
    assert true.scale == made.scale
    gap = compute_difference(made, true)  # both moved as far from their own rest
    np.testing.assert_allclose(gap.values[np.isfinite(gap.values)], 0.0, atol=1e-4)


def test_a_trace_says_which_way_the_membrane_went(bubble):
    rest = make_reference_touch(bubble)
    moved = np.zeros(bubble.camera.shape, np.float32)
    moved[0, 1] = -0.5
    touch = replace(
        rest,
        membrane=replace(rest.membrane, indentation_mm=moved),
        source_index=np.arange(moved.size, dtype=np.int32).reshape(moved.shape),
    )
    assert (
        "0.50 mm out"
        in TOUCH.trace_point(touch, ProbePoint(stage="target_depth", index=1, text="")).text
    )
    assert (
        "0.00 mm in"
        in TOUCH.trace_point(touch, ProbePoint(stage="target_depth", index=2, text="")).text
    )


def test_differences_of_all_frames_share_one_scale(bubble, pressed):
    true = make_frame_preview(pressed, bubble.camera, bubble, DISPLAY)
    for off_mm in (0.12, 0.7, 1e-4, 3.0):
        made = replace(true, values=true.values + np.float32(off_mm))
        assert compute_difference(made, true).scale.high == pytest.approx(2.0)
