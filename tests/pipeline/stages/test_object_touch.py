"""The touch by the registered object: presses of a mesh that no network has seen."""

import math
from dataclasses import replace

import numpy as np
import pytest

from pipeline.core.geometry import rigid
from pipeline.core.graph import Graph
from pipeline.core.values.frames import TactileFrame
from pipeline.core.values.results import DepthErrorModel, GeneratedTouch, make_depth_map
from pipeline.physics.sensor_images import render_reference
from pipeline.physics.simulation import poses, shapes
from pipeline.physics.simulation.datasets import BUBBLE_DEEPER_MM
from pipeline.physics.simulation.press import move_bubble_closer, press_membrane, simulate_press
from pipeline.sensors.alignment import resolve_alignment
from pipeline.sensors.spec import load_sensor
from pipeline.stages.pose.signed_distances import PRESSED
from pipeline.stages.pose.warm_start import FOLLOWED
from pipeline.stages.touch import object_touch, t2d2
from pipeline.stages.touch.object_touch import ObjectParams, press_object
from pipeline.stages.touch.stage import OBJECT, STAGE
from pipeline.translation.catalogue import BUILT_IN
from pipeline.views.image_views import TOUCH

GEL = load_sensor("gelslim")
BUBBLE = move_bubble_closer(load_sensor("soft_bubble"), BUBBLE_DEEPER_MM)
SHAPE = "notched_elbow"
POSE = rigid.translation(1.0, -2.0, -0.7) @ rigid.rotation((0.03, -0.02, 0.4))


@pytest.fixture(scope="module")
def frame():
    press = simulate_press(shapes.make_shape(SHAPE).mesh, POSE, GEL, seed=3)
    return TactileFrame(sensor="gelslim", image=press.image, reference=render_reference(GEL))


@pytest.fixture(scope="module")
def truth():
    return simulate_press(shapes.make_shape(SHAPE).mesh, POSE, BUBBLE, seed=None)


@pytest.fixture(scope="module")
def graph():
    return Graph(
        BUILT_IN.methods("t2d2", {"touch": "object"}, {"source": "gel", "target": "bubble"})
    )


def translate(graph, frame, mesh, **params):
    inputs = {
        "frame": frame,
        "source": GEL,
        "target": BUBBLE,
        "calibration": None,
        "mesh": mesh,
        "previous": None,
        "previous_membrane": None,
        "alignment": resolve_alignment(GEL, BUBBLE),
        "touch_weights": t2d2.select_weights(GEL, BUBBLE, None),
    }
    chosen = {"touch": ObjectParams(**params)} if params else {}
    return graph.evaluate(["touch"], inputs, chosen)["touch"]


def test_the_object_is_pressed_beyond_what_the_source_sees(graph, frame, truth):
    mesh = shapes.make_shape(SHAPE).mesh
    touch = translate(graph, frame, mesh).output
    physics = graph.with_methods(BUILT_IN.methods("t2d2", {"touch": "physics"}, {"source": "gel"}))
    rendered = translate(physics, frame, mesh).output
    error, by_physics = (
        np.abs(one.membrane.indentation_mm - truth.indentation_mm)[truth.contact].mean()
        for one in (touch, rendered)
    )
    assert error < 0.2 * by_physics
    assert (touch.membrane.contact & truth.contact).sum() > 0.9 * (
        touch.membrane.contact | truth.contact
    ).sum()
    assert touch.membrane.expected_error_mm.shape == BUBBLE.camera.shape
    assert touch.membrane.expected_error_mm.max() > 0
    assert np.array_equal(touch.source_index, rendered.source_index), "a probe finds the source"


def test_every_pose_that_fits_is_a_step_and_the_best_one_the_answer(graph, frame):
    mesh = shapes.make_shape(SHAPE).mesh
    touch = translate(graph, frame, mesh, samples=3, keep_states=True).output
    assert np.array_equal(touch.steps[-1].image, touch.image)
    assert len(touch.steps) >= 4
    assert all(math.isnan(step.sigma) for step in touch.steps)
    history = TOUCH.summarise_steps(touch)
    assert len(history.descriptions) == len(touch.steps)
    assert history.curves[0].values[-1] == 0.0
    plain = translate(graph, frame, mesh, samples=3).output
    assert not plain.steps
    assert plain.image.tobytes() == touch.image.tobytes()


def test_the_pose_at_which_the_object_is_pressed_is_its_pose(frame):
    mesh = shapes.make_shape(SHAPE).mesh
    route = Graph(BUILT_IN.methods("object", {}, {"source": "gel", "target": "bubble"}))
    inputs = {
        "frame": frame,
        "source": GEL,
        "target": BUBBLE,
        "calibration": None,
        "mesh": mesh,
        "previous": None,
        "alignment": resolve_alignment(GEL, BUBBLE),
    }
    results = route.evaluate(["pose"], inputs, {})
    pose = results["pose"].output
    pressed = press_membrane(mesh, pose.sensor_from_object, BUBBLE)
    assert np.allclose(pressed.depth_mm, results["touch"].output.membrane.depth_mm, atol=1e-3)
    assert PRESSED in pose.notes
    assert pose.scene_mm.shape == (len(pose.source_index), 3)


@pytest.mark.parametrize(("stated_mm", "is_refused"), [(0.05, True), (0.3, False)])
def test_a_mesh_is_refused_by_what_the_depth_can_be_off_by(stated_mm, is_refused):
    """A sphere in place of a cone: a small contact, whose rms over the image is small too."""
    cone = shapes.make_shape("cone").mesh
    press = simulate_press(cone, poses.make_paper_grid(cone, n=1, seed=2)[0], GEL, seed=None)
    depth = make_depth_map(GEL.rest_depth_mm, press.indentation_mm, press.contact, GEL.camera)
    depth = replace(depth, error=DepthErrorModel(rms_mm=stated_mm, correlation_mm=3.7))
    sphere = shapes.make_shape("sphere").mesh
    alignment = resolve_alignment(GEL, BUBBLE)
    touch = press_object(depth, GEL, alignment, BUBBLE, sphere, None, ObjectParams(samples=1))
    assert isinstance(touch, str) == is_refused


def test_an_object_on_a_bubble_is_followed_without_a_search(monkeypatch):
    mesh = shapes.make_shape(SHAPE).mesh

    def press(shift_mm, previous):
        pose = rigid.translation(shift_mm, 0.0, 0.0) @ POSE
        frame = simulate_press(mesh, pose, BUBBLE, seed=3)
        depth = make_depth_map(
            BUBBLE.rest_depth_mm, frame.indentation_mm, frame.contact, BUBBLE.camera
        )
        depth = replace(depth, measured_depth_mm=frame.image)
        alignment = resolve_alignment(BUBBLE, GEL)
        params = ObjectParams(samples=3)
        touch = press_object(depth, BUBBLE, alignment, GEL, mesh, previous, params)
        assert isinstance(touch, GeneratedTouch)
        return touch.membrane

    first = press(0.0, None)
    searched = press(0.2, None)
    monkeypatch.setattr(object_touch, "find_pose", None)
    followed = press(0.2, first.object_pose)
    assert FOLLOWED in followed.object_pose.notes
    off_mm = np.abs(followed.indentation_mm - searched.indentation_mm).mean()
    assert off_mm < searched.expected_error_mm.mean()


@pytest.mark.parametrize("mesh", ["none", "wrong"])
def test_without_a_mesh_that_fits_t2d2_answers_and_says_why(graph, frame, mesh):
    small = shapes.make_shape(SHAPE).mesh
    small = replace(small, vertices_mm=0.1 * small.vertices_mm)
    result = translate(graph, frame, None if mesh == "none" else small)
    assert result.fallback.startswith("T2D2: ")
    assert ("no object mesh" if mesh == "none" else "mesh") in result.fallback
    by_t2d2 = graph.with_methods(BUILT_IN.methods("t2d2", {}, {"source": "gel"}))
    assert np.array_equal(result.output.image, translate(by_t2d2, frame, None).output.image)


def test_no_contact_is_the_reference_image(graph, frame):
    untouched = replace(frame, image=frame.reference)
    result = translate(graph, untouched, shapes.make_shape(SHAPE).mesh)
    assert result.state == "skipped"
    assert np.array_equal(result.output.image, render_reference(BUBBLE))


def test_the_method_is_for_any_pair_of_sensors():
    assert OBJECT in STAGE.methods
    assert OBJECT.weights is None
