"""Touch by latent diffusion, the paper's generator: touch to touch (T2T), and touch to depth to
touch (T2D2).

Both sample the target's image from noise. T2T is conditioned on the source's image: as published in
the source's own view, or resampled to the target's (`image_condition.build_reprojected_square`).
T2D2 is conditioned on the target depth D_T'' and its mask M_T''. Images become mm in the paper's
three steps.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from pipeline.calibration.calibration_table import Calibration
from pipeline.core.arrays import Floats
from pipeline.core.errors import UnseenObjectWarning
from pipeline.core.frozen import frozen
from pipeline.core.graph import Fallback
from pipeline.core.params import setting
from pipeline.core.progress import SILENT, Progress
from pipeline.core.values.frames import TactileFrame
from pipeline.core.values.results import DepthMap, GeneratedTouch, TargetDepth
from pipeline.sensors.alignment import Alignment
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth import photometric as depth
from pipeline.stages.depth.frame_checks import check_frame
from pipeline.stages.networks import published_weights, weights_registry
from pipeline.stages.networks.network_factory import reproducible_inference
from pipeline.stages.networks.samplers import (
    GUIDED_STEPS,
    MAX_STEPS,
    MAX_WEIGHT,
    SOLVERS,
    WEIGHTS,
    GuidedDenoiser,
    Solver,
    make_timestep_schedule,
    plan_guidance,
    sample,
)
from pipeline.stages.networks.touch_formats import (
    answer_for_known_kinds,
    decode_image,
    get_touch_format,
    normalise,
    resize_from_square,
    resize_to_square,
)
from pipeline.stages.networks.weights import NoWeights, Weights
from pipeline.stages.touch import frame_chain, physical_render
from pipeline.stages.touch.frame_chain import check_depth_limit, make_touch_from_change
from pipeline.stages.touch.image_condition import build_reprojected_square
from pipeline.stages.touch.moved_touch import (
    find_motion,
    get_trained_alignment,
    press_moved_touch,
)
from pipeline.stages.touch.t2d2 import build_depth_square

if TYPE_CHECKING:
    from torch import Tensor, nn

Times = Literal["as trained", "leading", "trailing"]
_DRAFT_STEPS = 4
NOT_SHIPPED = (
    "no weights of latent diffusion are shipped; give the lab's checkpoints, or those of "
    "`tactoscope train latent`, with --weights"
)
OUTSIDE_VIEW = (
    "what a bubble feels outside the source's view is sampled: on small new objects its error "
    "over all is three times "
    "that of physics; compare with touch=physics"
)
NOTE = "image only, sampled from {}: the membrane is not known"


@frozen
class LatentParams:
    """Sampling settings; defaults are those of the paper."""

    steps: int = setting(
        200,
        "Denoising steps",
        unit="steps",
        low=1,
        high=MAX_STEPS,
        step=1,
        help="network passes from noise to the sample; guidance doubles them",
        pinned="Steps",
        sweep=GUIDED_STEPS,
        source="the paper: 200 steps; DDIM: Song et al. 2021",
    )
    guidance: float = setting(
        2.54,
        "Guidance scale",
        low=0.0,
        high=MAX_WEIGHT,
        step=0.1,
        help="strength of the condition; 1 is unguided and costs half",
        pinned="Guidance",
        sweep=WEIGHTS,
        source="Ho and Salimans 2022",
    )
    sampler: Solver = setting(
        "ddim",
        "Sampler",
        choices=SOLVERS,
        help="solver of the denoising steps",
        source="DDIM: Song et al. 2021; DPM-Solver++ 2M: Lu et al. 2022; corrected: after Zhao et "
        "al. 2023",
    )
    times: Times = setting(
        "as trained",
        "Times of the steps",
        choices=Times,
        help="leading is the published sampler's 901, 801 ... 1 for 10 steps and what the lab's "
        "checkpoints get; trailing begins at pure noise, as ours do",
        source="Lin et al. 2024",
    )
    seed: int = setting(
        0,
        "Seed",
        low=0,
        high=2**31 - 1,
        step=1,
        help="random seed of the sample",
        source="torch.Generator",
        pinned="Seed",
        sweep=tuple(range(8)),
    )
    threads: int = setting(
        1,
        "Threads",
        unit="threads",
        low=1,
        high=64,
        step=1,
        help="processor threads; large networks gain from more, which change the last digits",
        source="Tactoscope",
    )
    draft: bool = False  # fewer steps than requested


def make_draft_params(params: LatentParams) -> LatentParams:
    """Parameters while one is dragged: the fewest steps in which guidance has an effect."""
    return replace(params, steps=min(params.steps, _DRAFT_STEPS), draft=params.steps > _DRAFT_STEPS)


@answer_for_known_kinds
def select_weights(
    source: SensorSpec, target: SensorSpec, file: Path | None
) -> Weights | NoWeights:
    """The weights of a file for touch to touch; see `NOT_SHIPPED`."""
    found = _load_weights(target, file, is_t2d2=False)
    if isinstance(found, NoWeights) or found.config.get("condition") != "reprojected":
        return found
    if found.config.get("condition_inputs") != get_touch_format(source.kind).reprojected_channels:
        return NoWeights(
            why=f"the weights {found.name!r} do not translate from a {source.kind}; choose others"
        )
    return found


@answer_for_known_kinds
def select_t2d2_weights(
    source: SensorSpec,  # noqa: ARG001
    target: SensorSpec,
    file: Path | None,
) -> Weights | NoWeights:
    """The weights of a file for touch to depth to touch, for any source; see `NOT_SHIPPED`."""
    return _load_weights(target, file, is_t2d2=True)


def _load_weights(target: SensorSpec, file: Path | None, *, is_t2d2: bool) -> Weights | NoWeights:
    if file is None:
        return NoWeights(why=NOT_SHIPPED)
    task = published_weights.LATENT
    read = published_weights.read_latent_diffusion
    found = weights_registry.load_for_task(task, "", file, read, target.kind)
    if isinstance(found, NoWeights) or (found.config.get("condition") == "depth") == is_t2d2:
        return found
    given, wanted = (
        ("a source image", "a target depth") if is_t2d2 else ("a target depth", "a source image")
    )
    return NoWeights(
        why=f"the weights {found.name!r} generate a touch from {given}, not from {wanted}"
    )


def build_image_square(
    square_change: Floats,
    condition: str,
    source: SensorSpec,
    target: SensorSpec,
    alignment: Alignment,
) -> Floats:
    """(channels, side, side) of the source's change as a square, for T2T.

    `condition` is that of the network.
    """
    if condition == "reprojected":
        return build_reprojected_square(square_change, source, target, alignment)
    return np.broadcast_to(normalise(square_change, source.kind), (3, *square_change.shape[1:]))


def generate_touch(
    frame: TactileFrame,
    source_depth: DepthMap,  # noqa: ARG001 - read by its guard
    source: SensorSpec,
    calibration: Calibration | None,
    alignment: Alignment,
    target: SensorSpec,
    view: TargetDepth,
    network: nn.Module,
    params: LatentParams,
    progress: Progress = SILENT,
) -> GeneratedTouch | Fallback[GeneratedTouch]:
    """Generate what `target` would record of a frame in contact; deterministic per seed.

    A bubble's network generates the depths of the alignment that it was trained on, which physics
    presses at the one that is given. One step shows them: where they are deeper than the source can
    be pressed, physics answers and nothing is sampled. Raises ShapeError without a reference image.
    """
    check_frame(frame, source)
    assert frame.reference is not None  # checked
    net: Any = network
    square = resize_to_square(
        source.sensor_kind.compute_relative_change(frame.image, frame.reference), net.side
    )
    if net.raw_condition:
        square = square * np.float32(source.sensor_kind.full_change)
    checks_depth = target.sensor_kind.is_depth and not getattr(net, "trained_on_recordings", False)
    trained = get_trained_alignment(source) if checks_depth else alignment
    condition = build_image_square(square, net.condition, source, target, trained)
    render_params = physical_render.PhysicalRenderParams()
    if checks_depth:
        first = _sample_touch(
            condition, target, net, replace(params, steps=1, guidance=1.0), SILENT
        )
        impossible = check_depth_limit(first, source, target, trained)
        if impossible:
            physical = frame_chain.render_view(view, target, render_params, progress)
            return Fallback(result=physical, reason=f"physics: {impossible[0]}")
    touch = _sample_touch(condition, target, net, params, progress)
    limits = check_depth_limit(touch, source, target, trained) if checks_depth else ()
    motion = find_motion(trained, alignment)
    if motion is not None:
        touch = press_moved_touch(touch, motion, view, target, render_params, progress)
    warnings = (
        *depth.warn_of_mismatch(frame, source, calibration),
        *limits,
        *_warn_outside_view(target),
    )
    return replace(touch, notes=(*warnings, NOTE.format("the source image"), *touch.notes))


def generate_touch_from_depth(
    view: TargetDepth,
    target: SensorSpec,
    network: nn.Module,
    params: LatentParams,
    progress: Progress = SILENT,
) -> GeneratedTouch:
    """Generate what `target` would record of a target depth; deterministic per seed."""
    net: Any = network
    condition = build_depth_square(
        target.kind, view.indentation_mm, view.contact, view.in_view, net.side
    )
    touch = _sample_touch(condition, target, net, params, progress)
    return replace(
        touch, notes=(*_warn_outside_view(target), NOTE.format("the target depth"), *touch.notes)
    )


def _warn_outside_view(target: SensorSpec) -> tuple[UnseenObjectWarning, ...]:
    """A warning for a bubble, which feels more of an object than any source sees."""
    return (UnseenObjectWarning(OUTSIDE_VIEW),) if target.sensor_kind.is_depth else ()


def _sample_touch(
    condition: Floats, target: SensorSpec, net: Any, params: LatentParams, progress: Progress
) -> GeneratedTouch:
    """Sample an image and add it to the target's reference image."""
    encoded, notes = sample_image(net, condition, params, progress)
    generated = decode_image(encoded, target.kind)
    if net.half_turn:
        generated = generated[:, ::-1, ::-1]
    change = resize_from_square(np.ascontiguousarray(generated), target.camera.shape)
    return make_touch_from_change(target, change, notes)


def sample_image(
    net: Any, condition: Floats, params: LatentParams, progress: Progress = SILENT
) -> tuple[Floats, tuple[str, ...]]:
    """Sample an image (3, side, side) in -1..1 for a condition (channels, side, side).

    Also returns notes.
    """
    import torch

    from pipeline.stages.networks.latent_diffusion import LATENT_LIMIT, compute_alphas_cumprod

    is_leading = params.times == "leading" or (params.times == "as trained" and net.leading_times)
    levels, times = make_timestep_schedule(
        params.steps, compute_alphas_cumprod(), is_leading=is_leading
    )
    time_of = {float(level): time for level, time in zip(levels, times, strict=False)}
    guidance_plan = plan_guidance(
        params.guidance,
        len(times),
        LATENT_LIMIT,
        trained_with_condition_dropout=net.trained_with_condition_dropout,
    )

    def make_denoiser(embedding: Tensor) -> Any:
        def denoise(noisy: Tensor, sigma: float) -> Tensor:
            n = len(embedding)
            # trained on variance-preserving noise
            scaled_input = noisy / (1.0 + sigma * sigma) ** 0.5
            return noisy - sigma * net.predict_noise(
                scaled_input.expand(n, -1, -1, -1), torch.full((n,), time_of[sigma]), embedding
            )

        return denoise

    with reproducible_inference(params.threads):
        source_embedding = net.cond_stage_model(
            torch.from_numpy(np.array(condition, np.float32)[None])
        )
        rng = torch.Generator().manual_seed(params.seed)
        noise = torch.randn((1, 4, net.side // 8, net.side // 8), generator=rng)
        no_condition = torch.zeros_like(source_embedding)
        denoise_pair = make_denoiser(
            torch.cat([source_embedding, no_condition])
        )  # one batch of two is faster than two passes
        guided_denoiser = GuidedDenoiser(
            make_denoiser(source_embedding),
            make_denoiser(no_condition),
            guidance_plan,
            LATENT_LIMIT,
            lambda noisy, sigma: denoise_pair(noisy, sigma).split(1),
        )
        encoded = sample(
            guided_denoiser,
            noise,
            levels,
            solver=params.sampler,
            max_degree=guidance_plan.max_degree,
            progress=progress,
        )
        return net.decode_images(encoded.clean)[0].numpy(), (
            guidance_plan.note,
        ) if guidance_plan.note else ()
