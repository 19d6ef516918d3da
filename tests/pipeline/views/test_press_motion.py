"""The press in motion ends in the frame itself, and begins at rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.core.geometry import rigid
from pipeline.sensors.alignment import resolve_alignment
from pipeline.sensors.spec import load_sensor
from pipeline.views.colours import ColourScale, apply_colour_map
from pipeline.views.layers import Layer, make_grid_layer
from pipeline.views.press_motion import PressMotion
from pipeline.views.preview import Preview
from pipeline.views.scene import find_scene_places, make_scene_layers

SOURCE, TARGET = load_sensor("gelslim"), load_sensor("soft_bubble")
ALIGNMENT = resolve_alignment(SOURCE, TARGET)
PLACES = find_scene_places(ALIGNMENT, ALIGNMENT)
SCALE = ColourScale(colour_map="viridis", low=0.0, high=10.0, unit="mm", quantity="indentation")
PRESSED, STILL = 0.8, 0.0  # times at which the whole depth is shown, and none of it


def _surface(name, sensor, deepest_mm):
    """A dent in the middle of a sensor, and its indentation."""
    camera = sensor.camera.scale(40 / sensor.camera.cols)
    rest = sensor.membrane.rest_depth_mm(camera)
    rows, cols = np.mgrid[-1 : 1 : 1j * camera.rows, -1 : 1 : 1j * camera.cols]
    dent = np.maximum(0.0, deepest_mm * (1.0 - 4.0 * (rows**2 + cols**2)))
    preview = Preview(pixels=apply_colour_map(dent, SCALE), frame_name="", scale=SCALE)
    return make_grid_layer(name, camera.back_project(rest - dent), preview)


@pytest.fixture(scope="module")
def layers():
    dents = {
        "depth": (_surface("depth", SOURCE, 1.0),),
        "source": (_surface("source", SOURCE, 0.0),),
        "touch_depth": (_surface("touch_depth", TARGET, 6.0),),
        "pose": (
            Layer(
                name="object",
                points_mm=np.zeros((3, 3), np.float32),
                rgb=np.zeros((3, 3), np.uint8),
                triangles=np.array([[0, 1, 2]], np.int32),
                view_from_layer=rigid.translation(0.0, 0.0, 90.0),
            ),
        ),
    }
    return make_scene_layers(dents, SOURCE, TARGET, PLACES)


def _named(layers):
    return {layer.name: layer for layer in layers}


def _indentation_mm(layer, sensor):
    x, y, z = layer.points_mm.astype(np.float64).T
    return sensor.membrane.depth_at(x, y) - z


def test_pressed_it_is_the_frame_and_at_rest_nothing_is_moved(layers):
    motion = PressMotion(layers, SOURCE, TARGET, PLACES)
    frame, pressed, still = (
        _named(some) for some in (layers, motion.make_layers(PRESSED), motion.make_layers(STILL))
    )
    for name in ("source", "touch_depth"):
        assert pressed[name] is frame[name]
    np.testing.assert_allclose(
        pressed["object"].view_from_layer, frame["object"].view_from_layer, atol=1e-9
    )
    assert np.abs(_indentation_mm(still["source"], SOURCE)).max() < 1e-4
    assert np.abs(_indentation_mm(still["touch_depth"], TARGET)).max() < 1e-4
    assert (still["touch_depth"].rgb == apply_colour_map(np.zeros(1), SCALE)).all()
    # it comes along the optical axis, from beyond the touch
    way = still["object"].view_from_layer[:3, 3] - frame["object"].view_from_layer[:3, 3]
    axis = PLACES.view_from_source[:3, 2]
    assert way @ axis > 1.0
    np.testing.assert_allclose(way, (way @ axis) * axis, atol=1e-9)


@settings(max_examples=30, deadline=None)
@given(time=st.floats(0.0, 1.0))
def test_every_depth_and_colour_is_one_share_of_the_frames(layers, time):
    frame = _named(layers)
    at = _named(PressMotion(layers, SOURCE, TARGET, PLACES).make_layers(time))
    for name, sensor in (("source", SOURCE), ("touch_depth", TARGET)):
        whole, now = (_indentation_mm(some[name], sensor) for some in (frame, at))
        share = now.max() / whole.max()
        assert -1e-4 < share < 1.0 + 1e-4
        np.testing.assert_allclose(now, share * whole, atol=1e-3)
    off = apply_colour_map(now, SCALE).astype(int) - at["touch_depth"].rgb
    assert np.abs(off).max() <= 6  # the next but one colour at most
    ends = at["rays"].points_mm.reshape(2, -1, 2, 3)
    assert np.isfinite(ends).all()
    letters = PLACES.labels
    np.testing.assert_allclose(ends[0, :, 0], [letters["S"]] * ends.shape[1], atol=1e-4)
    np.testing.assert_allclose(ends[1, :, 0], ends[0, :, 1])


def test_rays_arrive_at_the_target_through_the_touch(layers):
    at = _named(PressMotion(layers, SOURCE, TARGET, PLACES).make_layers(PRESSED))
    ends = at["rays"].points_mm.reshape(2, -1, 2, 3)
    np.testing.assert_allclose(ends[1, :, 1], [PLACES.labels["T"]] * ends.shape[1], atol=1e-3)
    in_source = rigid.apply(rigid.invert(PLACES.view_from_source), ends[0, :, 1].astype(float))
    drawn = at["source"].points_mm
    nearest = np.linalg.norm(in_source[:, None] - drawn[None], axis=-1).min(axis=1)
    assert nearest.max() < 1e-3
    dents = _indentation_mm(at["source"], SOURCE)
    assert dents.max() == pytest.approx(1.0, abs=0.05)


def test_a_distance_keeps_its_colours(layers):
    scale = ColourScale(colour_map="viridis", low=40.0, high=90.0, unit="mm", quantity="distance")
    far = [replace(layer, scale=scale) if layer.scale else layer for layer in layers]
    still = _named(PressMotion(far, SOURCE, TARGET, PLACES).make_layers(STILL))
    assert (still["touch_depth"].rgb == _named(layers)["touch_depth"].rgb).all()
