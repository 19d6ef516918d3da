"""Sampling what a first answer misses: steps, guidance, sampler and seed of the methods by diffusion.

One step gives the posterior's middle, the best single guess; four and more give a sample, one touch of those that the
condition allows. No step at all leaves the first answer as it is.

Below the least noise that a network was taught nothing is sampled any more: its last answer is the middle of all that
are alike but for that noise, and where less than that is open samples come out all alike. What is left open there is
drawn at once (`settled`), as the last step of ancestral sampling does (Ho et al. 2020), from the error that the network
tells: a field of spread s seen through noise of strength n is known to n s / sqrt(n^2 + s^2). A gel's picture shows
slopes, of which such noise has more than any touch: its samples end with the middle.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.base.arrays import Floats, freeze
from pipeline.base.params import setting
from pipeline.base.progress import SILENT, Progress
from pipeline.networks.guidance import MAX_WEIGHT, GuidedDenoiser, plan_guidance
from pipeline.networks.samplers import MAX_STEPS, Solver, make_sigma_schedule, sample

if TYPE_CHECKING:
    from torch import Tensor, nn

LOG_ERROR_RANGE = -5.0, 2.5  # of the expected error, in the network's unit
_DRAFTED = 4  # steps
_MOST_KEPT = 50  # states: a thousand of them would fill the memory


@dataclass(frozen=True, slots=True, kw_only=True)
class DiffusionParams:
    """How the target's touch is sampled."""

    steps: int = setting(
        1, "Denoising steps", unit="steps", low=0, high=MAX_STEPS, step=1,
        help="0: what it begins with; 1: the likeliest touch; 4 to 8: one of those that are possible",
        source="Karras et al. 2022, eq. 5",
    )  # fmt: skip
    guidance: float = setting(
        1.0, "Guidance scale", unit="x", low=0.0, high=MAX_WEIGHT, step=0.1,
        help="how much more the condition counts than it was learned to; 1 costs half as much as any other above 0",
        source="Ho and Salimans 2022",
    )  # fmt: skip
    sampler: Solver = setting(
        "corrected",
        "Sampler",
        choices=Solver,
        help="how a step follows from those before it",
        source="DDIM: Song et al. 2021; DPM-Solver++ 2M: Lu et al. 2022; corrected: after Zhao et al. 2023",
    )
    seed: int = setting(
        0, "Seed", low=0, high=2**31 - 1, step=1, help="of the sample, and of the sensor's noise",
        source="torch's and numpy's own generators",
    )  # fmt: skip
    confidence_weighting: float = setting(
        1.0, "Caution", unit="share", low=0.0, high=1.0, step=0.1,
        help="in one step: 1 leaves it to physics where the network expects to be off by as much; 0 takes all it says",
        source="Wiener's gain, m^2 / (m^2 + s^2) of the middle m and the expected error s",
    )  # fmt: skip
    keep_states: bool = setting(
        False, "Keep states", help="so that the way to the sample can be looked at", source="our own; changes no answer"
    )  # fmt: skip
    add_noise: bool = setting(
        False, "Sensor noise", help="add the target sensor's own noise to the reading",
        source="measured or assumed, in the sensor's description",
    )  # fmt: skip
    draft: bool = False  # fewer steps than were asked for


def make_draft_params(params: DiffusionParams) -> DiffusionParams:
    """What to show while a parameter is dragged: the fewest steps in which guidance does anything, no states."""
    return replace(params, steps=min(params.steps, _DRAFTED), keep_states=False, draft=params.steps > _DRAFTED)


@dataclass(frozen=True, slots=True, kw_only=True)
class DenoisingState:
    """A clean residual as it was expected on the way; mm and likelihood, each (rows, cols)."""

    sigma: float  # of the noise that it was seen through, in the network's unit
    residual_mm: Floats
    contact_correction: Floats  # what is to be added to that of the first answer


@dataclass(frozen=True, slots=True, kw_only=True)
class ResidualSample:
    """The sample itself, what its error is expected to be, and how it was come by."""

    final: DenoisingState
    expected_error_mm: Floats  # (rows, cols)
    passes: int
    states: tuple[DenoisingState, ...]
    notes: tuple[str, ...]


def sample_residual(
    network: nn.Module,
    condition: Floats,
    params: DiffusionParams,
    progress: Progress = SILENT,
    *,
    draw_last_noise: bool = False,
) -> ResidualSample:
    """The residual that `network` (of `residual_denoiser`) samples for a condition (channels, rows, cols).

    `draws`: what the last of several steps leaves open is drawn, too (`settled`). The same seed gives the same bytes.
    Raises Cancelled between any two passes, SettingProblem for what is out of range. A guidance of 0 or 1, and every
    one that works nowhere, costs one pass a step.
    """
    import torch

    from pipeline.networks.smooth_noise import correlate_noise

    net: Any = network
    shown = torch.from_numpy(np.array(condition, np.float32)[None])
    first: list[Tensor] = []
    between = _Between(progress)

    def make_denoiser(shown_condition: Tensor) -> Callable[[Tensor, float], Tensor]:
        def denoise(noisy: Tensor, sigma: float) -> Tensor:
            between.report_again()
            answer: Tensor = net(noisy, torch.full((1,), sigma), shown_condition)
            if not first and shown_condition is shown:
                first.append(answer)
            return answer[:, :2]

        return denoise

    how = plan_guidance(params.guidance, params.steps, net.field_limit)
    denoise = GuidedDenoiser(make_denoiser(shown), make_denoiser(torch.zeros_like(shown)), how, net.field_limit)
    with torch.inference_mode():
        rng = torch.Generator().manual_seed(params.seed)
        noise = torch.zeros((1, 2, *shown.shape[2:]))  # of one step nothing is seen through it
        if params.steps > 1:
            noise = correlate_noise(torch.randn(noise.shape, generator=rng), net.noise_correlation)
        levels = make_sigma_schedule(params.steps, sigma_max=net.sigma_max, sigma_min=net.sigma_min)
        found = sample(
            denoise, noise, levels, solver=params.sampler, max_degree=how.max_degree, keep_steps=params.keep_states,
            progress=between,
        )  # fmt: skip
        if not first:  # never asked with its condition: guidance 0
            first.append(net(noise * net.sigma_max, torch.full((1,), net.sigma_max), shown))
        told, clean = first[0][0, 2].clamp(*LOG_ERROR_RANGE).exp(), found.clean
        if draw_last_noise and params.steps > 1:
            clean, fresh = clean.clone(), correlate_noise(torch.randn(told.shape, generator=rng), net.noise_correlation)
            clean[0, 0] = sample_below_sigma_min(clean[0, 0], told, float(levels[-2]), fresh).clip(
                -net.field_limit, net.field_limit
            )
    spread = net.unit_mm * told.numpy()

    def make_state(sigma: float, clean: Tensor) -> DenoisingState:
        field = clean[0].numpy()
        return DenoisingState(
            sigma=sigma, residual_mm=freeze(net.unit_mm * field[0]), contact_correction=freeze(field[1].copy())
        )

    stride = max(1, -(-len(found.steps) // _MOST_KEPT))
    kept = found.steps[::-1][::stride][::-1]  # the last one is among them
    return ResidualSample(
        final=make_state(0.0, clean), expected_error_mm=freeze(spread.astype(np.float32)), passes=denoise.passes,
        states=tuple(make_state(step.sigma, clean if step is kept[-1] else step.clean) for step in kept),
        notes=(how.note,) if how.note else (),
    )  # fmt: skip


def sample_below_sigma_min(mean: Tensor, mean_error: Tensor, sigma_min: float, noise: Tensor) -> Tensor:
    """One of the fields that noise of strength `least` hides: their `middle`, their mean error as it is `told`."""
    import torch

    spread = math.sqrt(0.5 * math.pi) * mean_error  # of normal numbers with that mean error
    return mean + noise * sigma_min * spread / torch.sqrt(spread**2 + sigma_min**2)


class _Between:
    """Passes on how far it is, and once more between the two passes of a guided step: it may be cancelled there."""

    def __init__(self, progress: Progress) -> None:
        self._progress, self._told = progress, (0.0, "")

    def step(self, fraction: float, text: str) -> None:
        """Report, or raise."""
        self._told = fraction, text
        self.report_again()

    def report_again(self) -> None:
        """Report the same, or raise."""
        self._progress.step(*self._told)
