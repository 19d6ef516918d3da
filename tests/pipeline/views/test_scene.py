"""The scene of both sensors: every layer is where the alignment puts it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.core.geometry import rigid
from pipeline.sensors.alignment import Alignment
from pipeline.sensors.spec import load_sensor
from pipeline.views.colours import repeat_colour
from pipeline.views.layers import Layer
from pipeline.views.scene import compute_scene_bounds, find_scene_places, make_scene_layers
from pipeline.views.scene_drawing import make_view

SENSORS = ("gelslim", "soft_bubble", "digit")
triples = st.tuples(*[st.floats(-90.0, 90.0)] * 3)
poses = st.builds(rigid.from_parts, triples, triples)


def _point(name: str, xyz, **more) -> Layer:
    points = np.array([xyz], dtype=np.float32)
    return Layer(name=name, points_mm=points, rgb=repeat_colour((9, 9, 9), 1), **more)


def _find(layers, name):
    layer = next(layer for layer in layers if layer.name == name)
    at = np.eye(4) if layer.view_from_layer is None else layer.view_from_layer
    return rigid.apply(at, layer.points_mm.astype(np.float64))


@settings(max_examples=40, deadline=None)
@given(
    source=st.sampled_from(SENSORS),
    target=st.sampled_from(SENSORS),
    inward=poses,
    onward=poses,
    in_object=poses,
    point=triples,
)
def test_a_point_of_source_and_target_is_where_the_alignment_says(
    source, target, inward, onward, in_object, point
):
    """One point in the frames of both sensors is one point of the scene."""
    alignment = Alignment(alignment_from_source=inward, target_from_alignment=onward)
    in_target = rigid.apply(alignment.target_from_source, point)
    on_object = rigid.apply(rigid.invert(in_object), in_target)
    places = find_scene_places(alignment, alignment)
    layers = make_scene_layers(
        {
            "source": (_point("source", point),),
            "touch_depth": (_point("touch_depth", in_target), _point("membrane", in_target)),
            "pose": (
                _point("scene", in_target),
                _point("object", on_object, view_from_layer=in_object),
            ),
        },
        load_sensor(source),
        load_sensor(target),
        places,
        (_point("touch", in_target),),
    )
    names = [layer.name for layer in layers]
    assert len(set(names)) == len(names)
    expected = rigid.apply(inward, point)
    image = "source membrane" if source == "soft_bubble" else "source"
    for name in (image, "touch_depth", "object", "recorded"):
        np.testing.assert_allclose(_find(layers, name)[0], expected, atol=1e-3)
    labels = places.labels
    np.testing.assert_allclose(labels["S"], inward[:3, 3], atol=1e-9)
    # what T_S->A and T_A->T lead from and to
    links = _find(layers, "links")
    np.testing.assert_allclose(links[[0, 1]], [labels["S"], labels["A"]], atol=1e-4)
    np.testing.assert_allclose(links[[2, 3]], [labels["A"], labels["T"]], atol=1e-4)
    np.testing.assert_allclose(_find(layers, "source camera")[8], labels["S"], atol=1e-3)
    np.testing.assert_allclose(_find(layers, "target camera")[8], labels["T"], atol=1e-3)


@pytest.mark.parametrize(
    ("source", "target"), [("gelslim", "soft_bubble"), ("soft_bubble", "gelslim"), ("digit",) * 2]
)
def test_the_view_holds_both_sensors(source, target):
    one, other = load_sensor(source), load_sensor(target)
    alignment = Alignment(
        alignment_from_source=one.alignment_from_sensor,
        target_from_alignment=rigid.invert(other.alignment_from_sensor),
    )
    bounds = compute_scene_bounds(one, other, alignment)
    layers = make_scene_layers({}, one, other, find_scene_places(alignment, alignment))
    camera, camera_from_scene = make_view(bounds, 400, 400)
    corners = np.concatenate([_find(layers, f"{role} camera") for role in ("source", "target")])
    x_px, y_px, _ = camera.project(rigid.apply(camera_from_scene, corners))
    seen = np.stack([x_px, y_px])
    assert 0.0 < seen.min() < 40.0
    assert 360.0 < seen.max() < 400.0
    spans = seen.max(axis=1) + seen.min(axis=1)
    np.testing.assert_allclose(spans, 400.0, atol=2.0)  # in the middle
