"""Networks at the ends of their parameters, on pictures that no touch makes: finite, in range,
or one sentence.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from pipeline.core.errors import SettingProblem
from pipeline.core.graph import Fallback, Skipped
from pipeline.core.params import NoParams
from pipeline.core.values.frames import TactileFrame
from pipeline.physics import optics
from pipeline.physics.simulation import shapes, variation
from pipeline.stages.depth import bubble_network
from pipeline.stages.depth.bubble_network import NetworkParams
from pipeline.stages.networks import network_factory, weights_registry
from pipeline.stages.networks.samplers import MAX_STEPS, MAX_WEIGHT
from pipeline.stages.pose import network as pose_network
from pipeline.stages.pose.signed_distances import (
    PoseParams,
    estimate_pose_icp,
    estimate_pose_planar,
)
from pipeline.stages.touch import latent_diffusion, t2d2, t2t, vqvae
from pipeline.stages.touch.latent_diffusion import LatentParams
from pipeline.stages.touch.residual_diffusion import DiffusionParams
from pipeline.stages.touch.t2d2 import T2D2Params
from tests.pipeline.stages.target_views import estimate_views
from tests.pipeline.stages.test_latent_diffusion_touch import make_depth_weights
from tests.stability.checks import outcome, sound
from tests.stability.rows import SIZE, row
from tests.stability.scenes import KINDS, aligned, indentation_mm, mesh, seeds, small, touch, view

STEPS = (0, 1, 2, 3, 8, *((999, MAX_STEPS) if SIZE.long else ()))  # a thousand take eight seconds
GUIDANCE = (0.0, 0.5, 1.0, 1.5, 2.54, 7.0, MAX_WEIGHT)
SOLVERS = ("ddim", "dpmpp_2m", "corrected")
PICTURES = ("black", "white", "hot pixel", "noise", "saturated", "flat", "untouched", "touch")
GEL = "gelslim"
BUBBLE = "soft_bubble"


def shipped(name):
    return network_factory.load_network(weights_registry.load_shipped(name))


def reading(spec, kind: str, seed: int) -> TactileFrame:
    """A frame that is all of one kind, with the reference image."""
    rng = np.random.default_rng(seed)
    gel = spec.kind == "gel"
    still = optics.render_reference(spec) if gel else spec.rest_depth_mm.astype(np.float32)
    low, high = (
        (0, 255)
        if gel
        else (np.float32(still.min() - spec.limits.indentation_max_mm), np.float32(still.max()))
    )
    image = still.copy()
    if kind in ("black", "white"):
        image[:] = low if kind == "black" else high
    elif kind == "flat":
        image[:] = (0.5 * (float(low) + float(high))) if not gel else 128
    elif kind == "hot pixel":
        image[tuple(int(rng.integers(n)) for n in image.shape[:2])] = high if gel else low
    elif kind == "noise":
        image[:] = rng.integers(0, 256, image.shape) if gel else rng.uniform(low, high, image.shape)
    elif kind in ("saturated", "touch"):
        pushed = np.minimum(
            indentation_mm(spec, "sphere", rng), spec.limits.indentation_max_mm
        ).astype(np.float32)
        image = (
            optics.render(spec, pushed, seed=None).copy()
            if gel
            else (still - pushed).astype(np.float32)
        )
        if kind == "saturated":
            image = (
                np.where(image > 140, 255, image).astype(np.uint8)
                if gel
                else np.where(pushed > 0, low, image)
            )
    return TactileFrame(sensor=spec.name, image=image, reference=still)


def translate(method, frame, source, target, network, params):
    """A touch by a method from image to image."""
    between = aligned(source, target)
    view_, found = estimate_views(frame, source, between, target)
    return method.generate_touch(
        frame, found, source, None, between, target, view_, network, params
    )


def answered(result):
    """What a method answers, whatever it is wrapped in."""
    if isinstance(result, Fallback):
        result = result.result
    return result.output if isinstance(result, Skipped) else result


def sound_touch(result, spec) -> None:
    """A picture without holes, and where there is a membrane one that the sensor can have."""
    if result is None:
        return  # refused in a sentence, of which the row counts how many
    found = answered(result)
    assert found.image.shape[:2] == spec.camera.shape
    assert found.image.dtype == np.uint8 if spec.kind == "gel" else np.isfinite(found.image).all()
    if found.membrane is None:
        return
    sound(found)
    moved = found.membrane.indentation_mm
    most = spec.limits.indentation_max_mm
    assert moved.max() <= most + 1e-4
    assert moved.min() >= -most - 1e-4, "farther out than it can be pressed in"
    assert (found.membrane.depth_mm > 0).all(), "behind its camera"
    if found.membrane.expected_error_mm is not None:
        assert np.isfinite(found.membrane.expected_error_mm).all()
        assert (found.membrane.expected_error_mm >= 0).all()
    for step in found.steps:
        assert np.isfinite(step.membrane.indentation_mm).all()


params = st.builds(
    T2D2Params,
    steps=st.sampled_from(STEPS),
    guidance=st.sampled_from(GUIDANCE),
    sampler=st.sampled_from(SOLVERS),
    confidence_weighting=st.floats(0.0, 1.0),
    seed=st.integers(0, 2**31 - 1),
    keep_states=st.booleans(),
    add_noise=st.booleans(),
)


@row(
    "12,1",
    "T2D2: any steps, guidance, caution and seed on any view, to a gel and a bubble",
    share=0.13,
    refused=0.3,
)
@given(
    st.sampled_from([(GEL, "t2d2_gelslim"), (BUBBLE, "t2d2_bubble")]),
    st.sampled_from(KINDS),
    params,
    seeds,
)
def test_t2d2(target, kind, how, seed):
    spec = small(target[0])
    result, _ = outcome(
        t2d2.generate_touch,
        view(spec, indentation_mm(spec, kind, np.random.default_rng(seed))),
        spec,
        shipped(target[1]),
        how,
    )
    sound_touch(result, spec)


@row(
    "12,2",
    "T2T: any steps, guidance, caution and seed on any picture, from units that differ",
    share=0.13,
    refused=0.35,
)
@given(st.sampled_from(PICTURES), params, seeds, st.floats(0.0, variation.MAX_STRENGTH))
@example("noise", DiffusionParams(steps=8, guidance=MAX_WEIGHT), 0, 0.0)
def test_t2t(picture, how, seed, strength):
    source = variation.vary_sensor(small(GEL), seed % 2**31, strength)
    target = small(BUBBLE)
    result, _ = outcome(
        translate,
        t2t,
        reading(source, picture, seed),
        source,
        target,
        shipped("t2t_bubble"),
        how,
    )
    sound_touch(result, target)


@row("12,3", "VQ-VAE: any picture, either way", share=0.13, refused=0.25)
@given(st.sampled_from([(GEL, BUBBLE), (BUBBLE, GEL)]), st.sampled_from(PICTURES), seeds)
def test_vqvae(way, picture, seed):
    source, target = (small(name) for name in way)
    result, _ = outcome(
        translate,
        vqvae,
        reading(source, picture, seed),
        source,
        target,
        shipped(f"vqvae_{way[0]}_to_{way[1]}"),
        NoParams(),
    )
    sound_touch(result, target)


@row(
    "12,4",
    "latent diffusion: any steps, guidance and solver on any picture",
    share=0.1,
    refused=0.25,
)
@given(
    st.sampled_from(PICTURES),
    st.sampled_from(STEPS[1:]),
    st.sampled_from(GUIDANCE),
    st.sampled_from(SOLVERS),
    seeds,
)
def test_latent(picture, steps, guidance, sampler, seed):
    source = small(GEL)
    target = small(BUBBLE)
    how = LatentParams(
        steps=steps,
        guidance=guidance,
        sampler=sampler,
        seed=seed % 2**31,
    )
    network = network_factory.load_network(make_depth_weights(condition="image"))
    network.trained_on_recordings = True  # its own answer, also where physics would replace it
    result, _ = outcome(
        translate,
        latent_diffusion,
        reading(source, picture, seed),
        source,
        target,
        network,
        how,
    )
    sound_touch(result, target)


@row(
    "12,5",
    "depth by network: any picture of units that differ, at any certainty",
    share=0.13,
    refused=0.25,
)
@given(
    st.sampled_from(PICTURES),
    st.floats(0.05, 0.95),
    seeds,
    st.floats(0.0, variation.MAX_STRENGTH),
)
def test_depth(picture, certainty, seed, strength):
    spec = variation.vary_sensor(small(BUBBLE), seed % 2**31, strength)
    ready = network_factory.load_predictor(weights_registry.load_shipped("bubble_depth"))
    result, _ = outcome(
        bubble_network.estimate_frame,
        reading(spec, picture, seed),
        spec,
        None,
        ready,
        NetworkParams(certainty=certainty),
    )
    if result is None:
        return
    found = answered(result)
    sound(found)
    moved = found.indentation_mm[np.isfinite(found.indentation_mm)]
    assert abs(moved).max(initial=0.0) <= spec.limits.indentation_max_mm + 1e-4
    if found.error is not None:
        assert np.isfinite(found.error.rms_mm)
        assert found.error.rms_mm >= 0


@row("12,6", "pose by network: any touch of any object, trained or not", share=0.13)
@given(
    st.sampled_from([GEL, BUBBLE]),
    st.sampled_from(PICTURES),
    st.sampled_from(KINDS),
    st.booleans(),
    seeds,
)
def test_pose(name, picture, kind, known, seed):
    spec = small(name)
    thing = shapes.make_shape("cross").mesh
    if not known:
        thing = replace(thing, vertices_mm=1e3 * thing.vertices_mm)
    touched = touch(spec, indentation_mm(spec, kind, np.random.default_rng(seed)))
    made = replace(
        t2d2.physical_render.make_reference_touch(spec),
        image=reading(spec, picture, seed).image,
        membrane=touched,
    )
    result, _ = outcome(
        pose_network.predict_pose,
        made,
        touched,
        spec,
        thing,
        shipped(f"pose_{name}"),
        PoseParams(max_points=50),
    )
    if result is not None:
        sound(answered(result))


@row(
    "12,7",
    "the paper's poses: any touch, iterations, search distance, points and face",
    share=0.13,
    refused=0.2,
)
@given(
    st.sampled_from([estimate_pose_icp, estimate_pose_planar]),
    st.sampled_from(["ball", "cross", "wave"]),
    st.sampled_from(KINDS),
    st.sampled_from([1, 2, 200]),
    st.sampled_from([0.05, 0.5, 20.0]),
    st.sampled_from([50, 1500]),
    st.sampled_from(["auto", "+z", "-x"]),
    st.sampled_from(["on it", "three pixels", "far off"]),
    seeds,
)
def test_the_papers_poses(method, thing, kind, n, far_mm, most, face, where, seed):
    spec = small("digit")
    touched = touch(spec, indentation_mm(spec, kind, np.random.default_rng(seed)))
    if where == "three pixels":
        few = np.zeros_like(touched.contact)
        few.flat[np.flatnonzero(touched.contact)[:3]] = True
        touched = replace(touched, contact=few)
    elif where == "far off":
        touched = replace(touched, depth_mm=touched.depth_mm + np.float32(900.0))
    how = PoseParams(
        n_iterations=n,
        max_distance_mm=far_mm,
        max_points=most,
        face=face,
        n_starts=2,
        keep_steps=True,
    )
    result, _ = outcome(method, touched, mesh(thing), how)
    if result is not None:
        sound(result)


@pytest.mark.parametrize(
    "wrong", [{"guidance": 15.1}, {"guidance": float("nan")}, {"steps": 1001}, {"guidance": -1.0}]
)
def test_what_is_out_of_range_is_refused_in_a_sentence(wrong):
    spec = small(BUBBLE)
    shown = view(spec, indentation_mm(spec, "sphere", np.random.default_rng(3)))
    with pytest.raises(SettingProblem):
        t2d2.generate_touch(
            shown, spec, shipped("t2d2_bubble"), replace(T2D2Params(steps=2), **wrong)
        )
