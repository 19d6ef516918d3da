"""The target's touch by latent diffusion: the paper's touch to touch, with its three steps that lead back to mm."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from pipeline.base.arrays import Floats
from pipeline.base.errors import ShapeError
from pipeline.base.params import setting
from pipeline.base.progress import SILENT, Progress
from pipeline.calibration.calibration_table import Calibration
from pipeline.engine.graph import Skipped
from pipeline.networks import latent_diffusion_files, weights_registry
from pipeline.networks.guidance import MAX_WEIGHT, GuidedDenoiser, plan_guidance
from pipeline.networks.samplers import MAX_STEPS, Solver, make_timestep_schedule, sample
from pipeline.networks.square_images import (
    compute_change,
    decode_image,
    normalise,
    resize_from_square,
    resize_to_square,
)
from pipeline.networks.weights import NoWeights, Weights
from pipeline.sensors.alignment import Alignment
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth import photometric as depth
from pipeline.stages.touch import physical_render
from pipeline.stages.touch.depth_limit import check_depth_limit
from pipeline.stages.touch.touch_from_change import make_touch_from_change
from pipeline.values.frames import TactileFrame
from pipeline.values.results import GeneratedTouch

if TYPE_CHECKING:
    from torch import Tensor, nn

_DRAFTED = 4
RawCondition = Literal["as trained", "yes", "no"]
NOTE = "a picture alone, sampled from the source's picture alone: no depth, no alignment and no membrane is behind it"


@dataclass(frozen=True, slots=True, kw_only=True)
class LatentParams:
    """How a touch is sampled; as they come, the paper's numbers."""

    steps: int = setting(
        200, "Denoising steps", unit="steps", low=1, high=MAX_STEPS, step=1,
        help="from noise to the sample; as many calls of the network, twice as many with guidance",
        source="the paper: 200 steps; DDIM: Song et al. 2021",
    )  # fmt: skip
    guidance: float = setting(
        2.54, "Guidance scale", unit="x", low=0.0, high=MAX_WEIGHT, step=0.1,
        help="how much more the source counts than it was learned to; 1 costs half as much as any other above 0",
        source="Ho and Salimans 2022",
    )  # fmt: skip
    sampler: Solver = setting(
        "ddim",
        "Sampler",
        choices=Solver,
        help="how a step follows from those before it",
        source="DDIM: Song et al. 2021; DPM-Solver++ 2M: Lu et al. 2022; corrected: after Zhao et al. 2023",
    )
    seed: int = setting(
        0, "Seed", low=0, high=2**31 - 1, step=1, help="of the sample", source="torch's own generator"
    )  # fmt: skip
    renormalise_depth: bool = setting(
        True, "Bring to the taught mean and spread", help="the paper's third step, of a bubble",
        source="the paper, touch to touch: from pictures back to mm",
    )  # fmt: skip
    raw_condition: RawCondition = setting(
        "as trained", "Condition in greys", choices=RawCondition,
        help="the published weights were taught on changes of 0..255 with the spread of 0..1",
        source="the released code and weights",
    )  # fmt: skip
    double_mapping: bool = setting(
        False, "Map to mm twice", help="as the released scripts do: all of an imprint in the upper half of its range",
        source="the released code",
    )  # fmt: skip
    draft: bool = False  # fewer steps than were asked for


def make_draft_params(params: LatentParams) -> LatentParams:
    """What to show while a parameter is dragged: the fewest steps in which guidance does anything."""
    return replace(params, steps=min(params.steps, _DRAFTED), draft=params.steps > _DRAFTED)


def select_weights(source: SensorSpec, target: SensorSpec, file: Path | None) -> Weights | NoWeights:
    """The weights of that very direction."""
    return weights_registry.load_for_task(
        latent_diffusion_files.TASK, f"latent_{source.name}_to_{target.name}", file, latent_diffusion_files.read_weights
    )


def generate_touch(
    frame: TactileFrame,
    source: SensorSpec,
    calibration: Calibration | None,
    alignment: Alignment,  # the network is not told: what is doubted of its touch
    target: SensorSpec,
    network: nn.Module,
    params: LatentParams,
    progress: Progress = SILENT,
) -> GeneratedTouch | Skipped:
    """What `target` would have recorded; the same seed gives the same bytes. Raises ShapeError without a reference."""
    depth.check_frame(frame, source)
    if frame.reference is None:
        raise ShapeError(f"the touch by latent diffusion needs {source.name}'s untouched reading; give --reference")
    if depth.skip_without_contact(frame, source, calibration, depth.DepthParams()) is not None:
        return Skipped(output=physical_render.make_reference_touch(target), reason=physical_render.NO_CONTACT)
    net: Any = network
    changed = resize_to_square(compute_change(source.kind, frame.image, frame.reference), net.side)
    if params.raw_condition == "yes" or (params.raw_condition == "as trained" and net.raw_condition):
        changed = changed * np.float32(source.sensor_kind.full_change)
    shown = normalise(changed, source.kind)
    found, notes = sample_image(net, np.broadcast_to(shown, (3, *shown.shape[1:])), params, progress)
    made = decode_image(found, target.kind, map_twice=params.double_mapping)
    if target.kind == "bubble" and params.renormalise_depth:
        made = _renormalise_depth(made, net.generated_stats, net.true_stats)
    if net.half_turn:
        made = made[:, ::-1, ::-1]
    touch = make_touch_from_change(target, resize_from_square(np.ascontiguousarray(made), target.camera.shape))
    doubtful = (
        *depth.warn_of_mismatch(frame, source, calibration),
        *check_depth_limit(touch, source, target, alignment),
    )
    return replace(touch, notes=(*doubtful, NOTE, *notes))


def sample_image(
    net: Any, shown: Floats, params: LatentParams, progress: Progress = SILENT
) -> tuple[Floats, tuple[str, ...]]:
    """A picture (3, side, side) in -1..1 for a condition of the same shape, and what was done otherwise than asked."""
    import torch

    from pipeline.networks.latent_diffusion import LATENT_LIMIT, compute_alphas_cumprod

    levels, times = make_timestep_schedule(params.steps, compute_alphas_cumprod())
    time_of = {float(level): time for level, time in zip(levels, times, strict=False)}
    how = plan_guidance(params.guidance, len(times), LATENT_LIMIT)

    def make_denoiser(embedding: Tensor) -> Any:
        def denoise(noisy: Tensor, sigma: float) -> Tensor:
            n = len(embedding)
            at = noisy / (1.0 + sigma * sigma) ** 0.5  # the network was taught on noise that keeps the spread
            return noisy - sigma * net.predict_noise(
                at.expand(n, -1, -1, -1), torch.full((n,), time_of[sigma]), embedding
            )

        return denoise

    with torch.inference_mode():
        told = net.cond_stage_model(torch.from_numpy(np.array(shown, np.float32)[None]))
        rng = torch.Generator().manual_seed(params.seed)
        noise = torch.randn((1, 4, net.side // 8, net.side // 8), generator=rng)
        untold = torch.zeros_like(told)
        both = make_denoiser(torch.cat([told, untold]))  # two at once cost less than one after the other
        guided = GuidedDenoiser(
            make_denoiser(told),
            make_denoiser(untold),
            how,
            LATENT_LIMIT,
            lambda noisy, sigma: both(noisy, sigma).split(1),
        )
        found = sample(guided, noise, levels, solver=params.sampler, max_degree=how.max_degree, progress=progress)
        return net.decode_images(found.clean)[0].numpy(), (how.note,) if how.note else ()


def _renormalise_depth(made_mm: Floats, made: tuple[float, float], true: tuple[float, float]) -> Floats:
    """An imprint renormalised from the mean and spread that the network's imprints had to those of true ones."""
    if made[1] <= 0.0 or true[1] <= 0.0:
        return made_mm
    return ((made_mm - made[0]) * (true[1] / made[1]) + true[0]).astype(np.float32)
