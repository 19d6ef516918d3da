"""Two images that are compared have one colour scale, and it does not follow what they show."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.core.values.results import make_depth_map
from pipeline.sensors.spec import load_sensor
from pipeline.translation.truth_view import build_observation_view
from pipeline.views.contrast import share_scale
from pipeline.views.display_params import DisplayParams
from pipeline.views.preview import make_indentation_preview


def make_preview(sensor, height_mm):
    heights = np.full(sensor.camera.shape, height_mm, np.float32)
    contact = np.ones(sensor.camera.shape, np.bool_)
    depth = make_depth_map(sensor.rest_depth_mm, heights, contact, sensor.camera)
    return make_indentation_preview(heights, depth, sensor, DisplayParams())


@pytest.mark.parametrize("name", ["gelslim", "soft_bubble"])
def test_the_difference_to_the_recorded_touch_keeps_its_scale_while_the_alignment_moves(name):
    sensor = load_sensor(name)
    at_rest = np.zeros(sensor.camera.shape, np.float32)
    touched = np.ones(sensor.camera.shape, np.bool_)
    observed = make_depth_map(sensor.rest_depth_mm, at_rest, touched, sensor.camera)
    scales = {
        build_observation_view(
            make_preview(sensor, gap_mm), observed, sensor, DisplayParams()
        ).difference_to_truth.scale
        for gap_mm in (0.0, 0.02, 0.1, 0.3, 2.0)
    }
    assert len(scales) == 1


def test_a_and_b_share_one_scale_where_their_sensors_have_other_ranges():
    gel = load_sensor("gelslim")
    bubble = load_sensor("soft_bubble")
    a = make_preview(gel, 0.5)
    b = make_preview(bubble, 0.5)
    assert a.scale.high != b.scale.high
    shared_a, shared_b = share_scale(a, b)
    assert {(shared.scale.low, shared.scale.high) for shared in (shared_a, shared_b)} == {
        (min(a.scale.low, b.scale.low), max(a.scale.high, b.scale.high))
    }
    assert np.array_equal(shared_a.pixels[0, 0], shared_b.pixels[0, 0]), "one height, one colour"
    assert share_scale(a, a) == (a, a)
