"""T2D2 and T2T between described sensors: what the network adds to physics, and what it must not
change.
"""

from dataclasses import replace

import numpy as np
import pytest
import torch

from pipeline.core.geometry import rigid
from pipeline.core.graph import Fallback, Graph, Skipped
from pipeline.core.progress import SILENT
from pipeline.core.values.frames import TactileFrame
from pipeline.core.values.results import TargetDepth, make_pixel_index
from pipeline.lab.training.denoising import TouchResidualTask
from pipeline.physics import optics
from pipeline.physics.simulation import poses, shapes
from pipeline.physics.simulation.datasets import BUBBLE_DEEPER_MM
from pipeline.physics.simulation.press import move_bubble_closer, simulate_press
from pipeline.sensors import alignment
from pipeline.sensors.spec import load_sensor
from pipeline.stages.cloud.back_projection import BackProjectionParams, back_project_depth
from pipeline.stages.depth import bubble_network
from pipeline.stages.depth import photometric as depth
from pipeline.stages.depth.bubble_network import NetworkParams
from pipeline.stages.networks import weights_registry
from pipeline.stages.networks.network_factory import load_network, load_predictor
from pipeline.stages.networks.weights import NoWeights, load_weights, save_weights
from pipeline.stages.target_depth.surface_projection import SurfaceProjectionParams, project_cloud
from pipeline.stages.touch import frame_chain, physical_render, t2d2, t2t
from pipeline.stages.touch.image_condition import IMAGE_CHANNELS
from pipeline.stages.touch.moved_touch import get_trained_alignment
from pipeline.stages.touch.residual_diffusion import DiffusionParams
from pipeline.stages.touch.stage import PHYSICS, T2D2, T2T
from pipeline.stages.touch.t2d2 import CONDITION_CHANNELS, T2D2Params, make_working_sensor
from pipeline.translation.catalogue import BUILT_IN
from tests.pipeline.stages.target_views import estimate_views

GEL = load_sensor("gelslim")
BUBBLE = load_sensor("soft_bubble")


def unweighted(**how):
    """Parameters without confidence weighting by default."""
    return T2D2Params(**{"confidence_weighting": 0.0, **how})


class ConstantDenoiser(torch.nn.Module):
    """A denoiser with constant output that records its conditions."""

    unit_mm = 1.0
    sigma_max = 8.0
    sigma_min = 0.02
    noise_correlation = 0.0
    error_factors = (1.0, 1.0)
    error_exponent = 1.0
    inputs = 13
    trained_on_recordings = 0.0

    def __init__(self, residual, contact=0.0, spread=0.1):
        super().__init__()
        self.said = (residual, contact, float(np.log(spread)))
        self.shown = []

    def forward(self, noisy, sigma, condition):
        self.shown.append(condition)
        return torch.stack([torch.full(noisy.shape[2:], float(v)) for v in self.said])[None]


def view_of(target, deep_mm=3.0):
    shape = target.camera.shape
    away = np.hypot(*np.meshgrid(*(np.arange(n) - n // 2 for n in shape), indexing="ij"))
    contact = (away < shape[0] / 12) & (deep_mm > 0)
    known = np.zeros(shape, bool)
    known[shape[0] // 3 : -shape[0] // 3, shape[1] // 3 : -shape[1] // 3] = True
    indentation = np.where(contact, np.float32(deep_mm), np.float32(0)).astype(np.float32)
    depth = np.where(contact, target.rest_depth_mm - deep_mm, np.nan).astype(np.float32)
    index = np.where(contact, make_pixel_index(shape), -1).astype(np.int32)
    return TargetDepth(
        depth_mm=depth,
        contact=contact,
        indentation_mm=indentation,
        camera=target.camera,
        source_index=index,
        in_view=known,
    )


@pytest.mark.parametrize("target", [BUBBLE, GEL], ids=["bubble", "gel"])
def test_zero_steps_give_the_physical_render_without_the_network(target):
    view = view_of(target, 0.5)
    net = ConstantDenoiser(1.0)
    physics = physical_render.render_touch(
        view, target, physical_render.PhysicalRenderParams(add_noise=True, seed=3)
    )
    answer = t2d2.generate_touch(view, target, net, unweighted(steps=0, add_noise=True, seed=3))
    touch = answer.result
    assert answer.reason == "physics: no denoising step"
    assert touch.image.tobytes() == physics.image.tobytes()
    assert touch.membrane.indentation_mm.tobytes() == physics.membrane.indentation_mm.tobytes()
    assert not net.shown


@pytest.mark.parametrize("target", [BUBBLE, GEL], ids=["bubble", "gel"])
def test_the_residual_is_added_and_the_image_rendered_again(target):
    view = view_of(target, 0.5)
    physics = physical_render.render_touch(view, target, physical_render.PhysicalRenderParams())
    touch = t2d2.generate_touch(view, target, ConstantDenoiser(0.2), unweighted())
    assert (
        np.abs(touch.membrane.indentation_mm - physics.membrane.indentation_mm - 0.2).max() < 1e-5
    )
    assert np.allclose(
        touch.membrane.depth_mm, target.rest_depth_mm - touch.membrane.indentation_mm, atol=1e-4
    )
    assert np.allclose(touch.membrane.expected_error_mm, 0.1)
    assert touch.in_view.all()
    if target is BUBBLE:
        assert np.allclose(touch.image, touch.membrane.depth_mm)
    else:
        same = optics.render(target, touch.membrane.indentation_mm, seed=None)
        assert np.array_equal(touch.image, same)
    assert any("expected error 0.1 mm" in note for note in touch.notes)


def test_bubble_samples_have_the_variance_below_the_least_noise_and_gel_samples_none():
    """The posterior mean is the same for every seed; samples differ by the last ancestral step."""

    def spread(target, expected):
        generated = [
            t2d2.generate_touch(
                view_of(target, 0.5),
                target,
                ConstantDenoiser(0.2, spread=expected),
                unweighted(steps=4, seed=s),
            )
            for s in range(4)
        ]
        return float(
            np.stack([touch.membrane.indentation_mm for touch in generated]).std(0, ddof=1).mean()
        )

    assert 0.6 * ConstantDenoiser.sigma_min < spread(BUBBLE, 1.0) < 1.2 * ConstantDenoiser.sigma_min
    assert 0.004 < spread(BUBBLE, 0.007) < 0.012, "no more than is open"
    assert spread(GEL, 1.0) < 1e-6


def test_a_zero_residual_keeps_the_render_and_contact_follows_the_network():
    view = view_of(GEL, 0.5)
    physics = physical_render.render_touch(view, GEL, physical_render.PhysicalRenderParams())
    answer = t2d2.generate_touch(view, GEL, ConstantDenoiser(0.0), unweighted())
    assert isinstance(answer, Fallback)
    nothing = answer.result
    assert np.array_equal(nothing.image, physics.image)
    assert np.array_equal(nothing.membrane.contact, physics.membrane.contact)
    everywhere = t2d2.generate_touch(view, GEL, ConstantDenoiser(0.0, contact=1.0), unweighted())
    assert everywhere.membrane.contact.all()
    assert f"{np.count_nonzero(~physics.membrane.contact)} px" in everywhere.notes[-1]
    assert not t2d2.generate_touch(
        view, GEL, ConstantDenoiser(0.0, contact=-1.0), unweighted()
    ).membrane.contact.any()


def test_contact_of_the_source_gel_is_kept_for_a_bubble():
    view = view_of(BUBBLE)
    touch = t2d2.generate_touch(view, BUBBLE, ConstantDenoiser(0.0, contact=-1.0), unweighted())
    assert touch.membrane.contact[view.contact].mean() > 0.95


def test_indentation_is_limited_to_the_sensor_maximum():
    touch = t2d2.generate_touch(view_of(GEL, 0.5), GEL, ConstantDenoiser(8.0), unweighted())
    assert touch.membrane.indentation_mm.max() <= GEL.limits.indentation_max_mm + 1e-6


def test_no_contact_needs_neither_weights_nor_network():
    answer = T2D2.run(
        view_of(BUBBLE, 0.0), BUBBLE, None, NoWeights(why="none"), unweighted(steps=200), SILENT
    )
    assert isinstance(answer, Skipped)
    assert not answer.output.membrane.contact.any()


def test_missing_weights_fall_back_to_physics_with_the_reason():
    view = view_of(BUBBLE)
    answer = T2D2.run(view, BUBBLE, None, NoWeights(why="none at hand"), unweighted(), SILENT)
    assert isinstance(answer, Fallback)
    assert "none at hand" in answer.reason
    physics = PHYSICS.run(view, BUBBLE, None, physical_render.PhysicalRenderParams(), SILENT)
    assert answer.result.image.tobytes() == physics.image.tobytes()


def test_kept_states_are_rendered_and_end_with_the_touch():
    touch = t2d2.generate_touch(
        view_of(GEL, 0.5), GEL, ConstantDenoiser(0.2), unweighted(steps=3, keep_states=True)
    )
    assert len(touch.steps) == 3
    assert np.array_equal(touch.steps[-1].image, touch.image)
    assert touch.steps[0].sigma == pytest.approx(8.0)


def test_the_condition_is_on_the_working_grid():
    net = ConstantDenoiser(0.0)
    t2d2.generate_touch(view_of(GEL, 0.5), GEL, net, unweighted())
    shown = net.shown[0]
    assert shown.shape == (1, CONDITION_CHANNELS, *make_working_sensor(GEL).camera.shape)
    ball_frames = shown[0, 3]
    assert 0.5 < ball_frames.sum() * 4 / view_of(GEL, 0.5).contact.sum() < 1.5
    assert torch.allclose(shown[0, 1][ball_frames > 0], torch.tensor(0.5 / 0.6), atol=1e-3)


@pytest.fixture(scope="module")
def ball_frames():
    """(frame of a GelSlim, frame of a bubble, its truth) under one ball."""
    thing = shapes.make_shape("sphere").mesh
    pose = poses.sample_press_pose(
        thing, np.random.default_rng(2), spread_mm=0.0, depth_mm=(0.8, 0.8)
    )
    under = simulate_press(thing, pose, GEL, seed=1)
    over = simulate_press(thing, pose, BUBBLE, seed=1)
    return (
        TactileFrame(sensor="gelslim", image=under.image, reference=optics.render_reference(GEL)),
        under.truth,
        TactileFrame(
            sensor="soft_bubble",
            image=over.image,
            reference=BUBBLE.rest_depth_mm.astype(np.float32),
        ),
        over.truth,
    )


def list_reads(frame, motion=None):
    """What T2T from a GelSlim to a bubble reads of a frame, but for weights.

    `motion` moves the bubble from where its network was trained.
    """
    between = get_trained_alignment(GEL)
    if motion is not None:
        between = alignment.correct_alignment(between, motion)
    view, found = estimate_views(frame, GEL, between, BUBBLE)
    return frame, found, GEL, None, between, BUBBLE, view


def test_the_condition_is_aligned_with_the_target(ball_frames):
    shown = t2t.build_condition(
        ball_frames[0], GEL, alignment.resolve_alignment(GEL, BUBBLE), BUBBLE
    )
    truth = ball_frames[3]
    assert shown.shape == (IMAGE_CHANNELS, *make_working_sensor(BUBBLE).camera.shape)
    change = np.abs(shown[:-2]).sum(0)
    known = shown[-2] > 0
    at = np.argwhere(truth.contact).mean(0) * np.array(change.shape) / truth.contact.shape
    weight = change * known * (change > 0.5 * change[known].max())
    found = (np.argwhere(weight > 0) * weight[weight > 0][:, None]).sum(0) / weight.sum()
    assert np.hypot(*(found - at)) * make_working_sensor(BUBBLE).pixel_mm < 1.0, (found, at)


def test_a_translated_alignment_translates_the_condition(ball_frames):
    between = alignment.resolve_alignment(GEL, BUBBLE)
    moved = alignment.correct_alignment(between, rigid.translation(4.3, 0.0, 0.0))
    plain, other = (
        t2t.build_condition(ball_frames[0], GEL, a, BUBBLE)[-2] for a in (between, moved)
    )
    shift = np.argwhere(other > 0).mean(0) - np.argwhere(plain > 0).mean(0)
    assert shift[1] == pytest.approx(4.3 * BUBBLE.camera.fx_px / 76.0, abs=0.8)
    assert abs(shift[0]) < 0.3


def test_t2t_is_the_network_alone_and_physics_without_steps(ball_frames):
    reads = list_reads(ball_frames[0])
    touch = t2t.generate_touch(*reads, ConstantDenoiser(1.0, contact=1.0), DiffusionParams())
    assert np.allclose(touch.membrane.indentation_mm, 1.0)
    assert touch.membrane.contact.all()
    physics = t2t.generate_touch(*reads, ConstantDenoiser(1.0), DiffusionParams(steps=0))
    assert isinstance(physics, Fallback)
    assert physics.result.membrane.indentation_mm.max() > 2.0
    sample = t2t.generate_touch(*reads, ConstantDenoiser(1.0), DiffusionParams(steps=2))
    assert np.abs(sample.membrane.indentation_mm - 1.0).max() < 5 * ConstantDenoiser.sigma_min


def test_the_condition_tells_how_far_the_sensors_overlap(ball_frames):
    between = alignment.resolve_alignment(GEL, BUBBLE)
    nearer = alignment.correct_alignment(between, rigid.translation(0.0, 0.0, -3.0))
    plain, other = (
        t2t.build_condition(ball_frames[0], GEL, a, BUBBLE)[-1] for a in (between, nearer)
    )
    assert 6.0 * plain.max() == pytest.approx(4.0, abs=0.1)  # soft_bubble.toml
    assert np.allclose(6.0 * (other - plain), 3.0, atol=0.05)


@pytest.mark.parametrize("closer_mm", [0.0, -3.0, -6.0])
def test_t2t_at_another_place_is_its_own_touch_pressed_there(closer_mm):
    """Both the network's touch, and what the source measured, move with the bubble."""
    mesh = shapes.make_shape("notched_elbow").mesh
    pose = rigid.translation(1.0, -2.0, -0.7) @ rigid.rotation((0.0, 0.0, 0.4))
    press = simulate_press(mesh, pose, GEL, seed=3)
    frame = TactileFrame(
        sensor="gelslim", image=press.image, reference=optics.render_reference(GEL)
    )
    weights = t2t.select_weights(GEL, BUBBLE, None)
    there = move_bubble_closer(BUBBLE, BUBBLE_DEEPER_MM + closer_mm)
    aside = rigid.rotation((0.0, 0.0, 0.3)) @ rigid.translation(2.0, -1.0, 0.0)
    there = replace(there, alignment_from_sensor=aside @ there.alignment_from_sensor)
    truth = simulate_press(mesh, pose, there, seed=None)
    between = alignment.resolve_alignment(GEL, there)
    view, found = estimate_views(frame, GEL, between, BUBBLE)
    answer = T2T.run(
        frame, found, GEL, None, between, BUBBLE, view, weights, DiffusionParams(), SILENT
    )
    physics = physical_render.render_touch(view, BUBBLE, physical_render.PhysicalRenderParams())
    off_mm, by_physics_mm = (
        np.abs(one.membrane.indentation_mm - truth.indentation_mm).mean()
        for one in (answer, physics)
    )
    assert off_mm < 0.7 * by_physics_mm


def test_t2t_reads_other_gels_by_their_depth():
    mini = load_sensor("gelsight_mini")
    dent = np.zeros(mini.camera.shape, np.float32)
    dent[80:160, 100:200] = 0.4
    image = optics.render(mini, dent, seed=1)
    frame = TactileFrame(sensor=mini.name, image=image, reference=optics.render_reference(mini))
    between = get_trained_alignment(mini)
    view, found = estimate_views(frame, mini, between, BUBBLE)
    answer = T2T.run(
        frame,
        found,
        mini,
        None,
        between,
        BUBBLE,
        view,
        T2T.weights(mini, BUBBLE, None),
        DiffusionParams(),
        SILENT,
    )
    assert not isinstance(answer, Fallback)
    assert answer.membrane.contact.any()


def test_t2t_skips_a_frame_without_contact(ball_frames):
    net = ConstantDenoiser(1.0)
    at_rest = replace(ball_frames[0], image=ball_frames[0].reference)
    answer = frame_chain.guard_contact(t2t.generate_touch)(
        *list_reads(at_rest), net, unweighted(steps=200), SILENT
    )
    assert isinstance(answer, Skipped)
    assert not net.shown


def test_t2t_without_weights_falls_back_to_the_render(ball_frames):
    answer = T2T.run(*list_reads(ball_frames[0]), NoWeights(why="none"), unweighted(), SILENT)
    assert isinstance(answer, Fallback)
    assert answer.result.membrane.contact.any()
    assert answer.result.membrane.indentation_mm.max() > 1.0


def test_weights_are_selected_by_sensors():
    for source in ("gelslim", "digit", "gelsight_mini"):
        assert isinstance(T2T.weights(load_sensor(source), GEL, None), NoWeights)
        assert not isinstance(T2T.weights(load_sensor(source), BUBBLE, None), NoWeights)
        found = T2D2.weights(load_sensor(source), BUBBLE, None)
        assert getattr(found, "why", "").find("pixels") < 0, "a source is no matter for T2D2"
    other = T2D2.weights(GEL, load_sensor("digit"), None)
    assert isinstance(other, NoWeights) == (not t2d2.has_trained_pixel_size(load_sensor("digit")))


@pytest.mark.parametrize(
    ("method", "file", "source", "target", "problem"),
    [
        ("t2t", "t2t_bubble", "gelslim", "gelslim", "not from a gel to a gel"),
        ("t2t", "t2t_bubble", "soft_bubble", "soft_bubble", "not from a bubble to a bubble"),
        ("t2d2", "", "soft_bubble", "gelslim", "less than the bubble's own error"),
        ("t2d2", "t2d2_bubble", "gelslim", "gelslim", "touches of a bubble, not of a gel"),
        ("t2t", "mine", "gelslim", "soft_bubble", "touches of a gel, not of a bubble"),
        ("t2d2", "mine", "gelslim", "soft_bubble", "touches of a gel, not of a bubble"),
        ("latent_t2d2", "mine", "gelslim", "soft_bubble", "touches of a gel, not of a bubble"),
    ],
)
def test_weights_of_another_direction_are_not_used(tmp_path, method, file, source, target, problem):
    path = weights_registry.WEIGHTS_FOLDER / f"{file}.safetensors" if file else None
    if file == "mine":
        shipped = load_weights(weights_registry.WEIGHTS_FOLDER / "t2d2_gelslim.safetensors")
        task = {"t2t": "touch_to_touch", "t2d2": "touch_residual", "latent_t2d2": "latent"}[method]
        path = tmp_path / "mine.safetensors"
        kind = task if task == "latent" else shipped.kind
        save_weights(
            path,
            replace(shipped, kind=kind, card={"task": task, weights_registry.TARGET_KIND: "gel"}),
        )
    found = BUILT_IN.method("touch", method).weights(load_sensor(source), load_sensor(target), path)
    assert isinstance(found, NoWeights)
    assert problem in found.why


@pytest.mark.parametrize("target", ["soft_bubble", "gelslim"])
def test_shipped_weights_are_better_than_physics_on_unseen_grasps(target):
    spec = load_sensor(target)
    found = T2D2.weights(load_sensor("digit"), spec, None)
    if isinstance(found, NoWeights):
        assert "shipped" in found.why, (
            "shipped weights that do not fit are no reason to answer by physics"
        )
        return
    net = load_network(found)
    task = TouchResidualTask(target=target)
    held_out = [task.make_validation_example("unseen_grasps", index) for index in range(6)]
    figures = task.evaluate(net, held_out)
    assert figures["error in contact, mm"] < 0.95 * figures["no-prediction error in contact, mm"]
    assert found.card["minutes"]


def test_a_route_without_depth_evaluates_the_default_depth_method_unseen(ball_frames):
    """The bubble network, so that T2T and T2D2 are compared with the same physics.

    Physics without its weights.
    """
    frame = ball_frames[2]
    between = alignment.resolve_alignment(BUBBLE, GEL)
    methods = BUILT_IN.methods("t2t", kinds={"source": "bubble", "target": "gel"})
    inputs = {
        "frame": frame,
        "source": BUBBLE,
        "target": GEL,
        "calibration": None,
        "alignment": between,
        "touch_weights": NoWeights(why="none"),
        "previous_membrane": None,
    }
    by_network = bubble_network.estimate_frame(
        frame,
        BUBBLE,
        None,
        load_predictor(bubble_network.select_weights(BUBBLE, BUBBLE, None)),
        NetworkParams(),
    )
    by_physics = depth.estimate_depth(frame, BUBBLE, None, depth.DepthParams())
    for seen, weights in (
        (by_network, bubble_network.select_weights(BUBBLE, GEL, None)),
        (by_physics, NoWeights(why="none")),
    ):
        view = project_cloud(
            back_project_depth(seen, between, BackProjectionParams()),
            GEL,
            SurfaceProjectionParams(),
        )
        expected = physical_render.render_touch(
            view, GEL, physical_render.PhysicalRenderParams()
        ).membrane
        results = Graph(methods).evaluate(["touch"], {**inputs, "depth_weights": weights}, {})
        assert list(results) == ["touch"]
        assert np.array_equal(results["touch"].output.membrane.contact, expected.contact)
