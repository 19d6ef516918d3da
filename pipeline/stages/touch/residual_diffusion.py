"""Sampling of the residual between a prior estimate and the true touch, for the diffusion methods.

One step gives the posterior mean, the best single estimate; four and more steps give a sample of
the posterior. No step leaves the prior unchanged.

Below the smallest training noise nothing is sampled: the last network output is the mean over all
fields that differ by less, and samples would lack that variance. It is added by one ancestral step
(Ho et al. 2020, see `sample_below_sigma_min`) from the predicted error: a field of standard
deviation s observed through noise n is known to n s / sqrt(n^2 + s^2). A gel's image shows slopes,
in which such noise exceeds any touch: its samples end with the mean.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from pipeline.core.arrays import Floats, freeze
from pipeline.core.params import setting
from pipeline.core.progress import SILENT, Progress
from pipeline.stages.networks.network_factory import reproducible_inference
from pipeline.stages.networks.onnx_predictor import FIELD_LIMIT, FirstPassPredictor, ResidualNetwork
from pipeline.stages.networks.samplers import (
    GUIDED_STEPS,
    MAX_STEPS,
    MAX_WEIGHT,
    WEIGHTS,
    GuidedDenoiser,
    Solver,
    make_sigma_schedule,
    plan_guidance,
    sample,
)

if TYPE_CHECKING:
    from torch import Tensor

LOG_ERROR_RANGE = -5.0, 2.5  # of the expected error, in `unit_mm`
_DRAFT_STEPS = 4  # steps while dragging
_MAX_KEPT_STATES = 50  # states; a thousand would exhaust the memory


@dataclass(frozen=True, slots=True, kw_only=True)
class DiffusionParams:
    """Sampling settings."""

    steps: int = setting(
        1,
        "Denoising steps",
        unit="steps",
        low=0,
        high=MAX_STEPS,
        step=1,
        help="0: physics only; 1: posterior mean; 4 to 8: a sample",
        pinned="Steps",
        sweep=GUIDED_STEPS,
        source="Karras et al. 2022, eq. 5",
    )
    guidance: float = setting(
        1.0,
        "Guidance scale",
        unit="x",
        low=0.0,
        high=MAX_WEIGHT,
        step=0.1,
        help="strength of the condition; 1 is unguided and costs half",
        pinned="Guidance",
        sweep=WEIGHTS,
        source="Ho and Salimans 2022",
    )
    sampler: Solver = setting(
        "corrected",
        "Sampler",
        choices=Solver,
        help="solver of the denoising steps",
        source="DDIM: Song et al. 2021; DPM-Solver++ 2M: Lu et al. 2022; corrected: after Zhao et "
        "al. 2023",
    )
    seed: int = setting(
        0,
        "Seed",
        low=0,
        high=2**31 - 1,
        step=1,
        help="random seed of the sample and the sensor noise",
        pinned="Seed",
        source="torch.Generator and numpy PCG64",
        sweep=tuple(range(8)),
    )
    keep_states: bool = setting(
        False,
        "Keep states",
        help="keep the denoising states for the step view; does not change the result",
        source="Tactoscope",
    )
    add_noise: bool = setting(
        False,
        "Sensor noise",
        help="add the target sensor's noise to the image",
        source="sensor description",
    )
    draft: bool = False  # fewer steps than requested


AnyParams = TypeVar("AnyParams", bound=DiffusionParams)


def make_draft_params(params: AnyParams) -> AnyParams:
    """Parameters while one is dragged: the fewest steps in which guidance has an effect, no kept
    states.
    """
    return replace(
        params,
        steps=min(params.steps, _DRAFT_STEPS),
        keep_states=False,
        draft=params.steps > _DRAFT_STEPS,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class DenoisingState:
    """The expected clean residual at one step, each field (rows, cols)."""

    sigma: float  # noise level, in `unit_mm`
    residual_mm: Floats
    contact_correction: Floats  # added to the contact of the prior


@dataclass(frozen=True, slots=True, kw_only=True)
class ResidualSample:
    """A sample, its expected error and its cost."""

    final: DenoisingState
    expected_error_mm: Floats  # (rows, cols)
    passes: int
    states: tuple[DenoisingState, ...]
    notes: tuple[str, ...]


def sample_residual(
    network: ResidualNetwork,
    condition: Floats,
    params: DiffusionParams,
    progress: Progress = SILENT,
    *,
    draw_last_noise: bool = False,
) -> ResidualSample:
    """Sample the residual of a condition (channels, rows, cols) with a `residual_denoiser`.

    `draw_last_noise`: the variance below the smallest noise is sampled too
    (`sample_below_sigma_min`). Deterministic per seed. Raises Cancelled between any two passes,
    SettingProblem for parameters out of range. A guidance of 0 or 1, and one without effect, costs
    one pass per step.
    """
    guidance_plan = plan_guidance(params.guidance, params.steps, FIELD_LIMIT)
    if isinstance(network, FirstPassPredictor):
        if params.steps == 1 and guidance_plan.weight == 1.0:
            return _take_first_pass(network, condition, params, guidance_plan.note, progress)
        network = network.load_network()
    import torch

    from pipeline.stages.networks.residual_denoiser import correlate_noise

    net: Any = network
    condition_batch = torch.from_numpy(np.array(condition, np.float32)[None])
    first_output: list[Tensor] = []
    repeated_progress = _RepeatedProgress(progress)

    def make_denoiser(shown_condition: Tensor) -> Callable[[Tensor, float], Tensor]:
        def denoise(noisy: Tensor, sigma: float) -> Tensor:
            repeated_progress.report_again()
            answer: Tensor = net(noisy, torch.full((1,), sigma), shown_condition)
            if not first_output and shown_condition is condition_batch:
                first_output.append(answer)
            return answer[:, :2]

        return denoise

    denoise = GuidedDenoiser(
        make_denoiser(condition_batch),
        make_denoiser(torch.zeros_like(condition_batch)),
        guidance_plan,
        FIELD_LIMIT,
    )
    with reproducible_inference():
        rng = torch.Generator().manual_seed(params.seed)
        noise = torch.zeros((1, 2, *condition_batch.shape[2:]))  # unused for a single step
        if params.steps > 1:
            noise = correlate_noise(torch.randn(noise.shape, generator=rng), net.noise_correlation)
        levels = make_sigma_schedule(params.steps, sigma_max=net.sigma_max, sigma_min=net.sigma_min)
        result = sample(
            denoise,
            noise,
            levels,
            solver=params.sampler,
            max_degree=guidance_plan.max_degree,
            keep_steps=params.keep_states,
            progress=repeated_progress,
        )
        if not first_output:  # guidance 0: never called with its condition
            first_output.append(
                net(noise * net.sigma_max, torch.full((1,), net.sigma_max), condition_batch)
            )
        expected_error = first_output[0][0, 2].clamp(*LOG_ERROR_RANGE).exp()
        clean = result.clean
        if draw_last_noise and params.steps > 1:
            clean = clean.clone()
            fresh_noise = correlate_noise(
                torch.randn(expected_error.shape, generator=rng), net.noise_correlation
            )
            clean[0, 0] = sample_below_sigma_min(
                clean[0, 0], expected_error, float(levels[-2]), fresh_noise
            ).clip(-FIELD_LIMIT, FIELD_LIMIT)
    error_std = net.unit_mm * expected_error.numpy()

    def make_state(sigma: float, clean: Tensor) -> DenoisingState:
        field = clean[0].numpy()
        return DenoisingState(
            sigma=sigma,
            residual_mm=freeze(net.unit_mm * field[0]),
            contact_correction=freeze(field[1].copy()),
        )

    stride = max(1, -(-len(result.steps) // _MAX_KEPT_STATES))
    kept_steps = result.steps[::-1][::stride][::-1]  # always includes the last
    return ResidualSample(
        final=make_state(0.0, clean),
        expected_error_mm=freeze(error_std.astype(np.float32)),
        passes=denoise.passes,
        states=tuple(
            make_state(step.sigma, clean if step is kept_steps[-1] else step.clean)
            for step in kept_steps
        ),
        notes=(guidance_plan.note,) if guidance_plan.note else (),
    )


def _take_first_pass(
    network: FirstPassPredictor,
    condition: Floats,
    params: DiffusionParams,
    note: str,
    progress: Progress,
) -> ResidualSample:
    """The posterior mean, without torch."""
    progress.step(0.0, "step 1 of 1")
    field, log_error = network.predict(condition)
    progress.step(1.0, "sampled")
    residual_mm = freeze(network.unit_mm * field[0])
    contact_correction = freeze(field[1].copy())
    mean = DenoisingState(sigma=0.0, residual_mm=residual_mm, contact_correction=contact_correction)
    error_mm = network.unit_mm * np.exp(log_error.clip(*LOG_ERROR_RANGE))
    return ResidualSample(
        final=mean,
        expected_error_mm=freeze(error_mm.astype(np.float32)),
        passes=1,
        states=(replace(mean, sigma=network.sigma_max),) if params.keep_states else (),
        notes=(note,) if note else (),
    )


def sample_below_sigma_min(
    mean: Tensor, mean_error: Tensor, sigma_min: float, noise: Tensor
) -> Tensor:
    """Sample around `mean` with the variance that noise of level `sigma_min` hides, given the
    mean absolute error.
    """
    import torch

    error_std = (
        math.sqrt(0.5 * math.pi) * mean_error
    )  # standard deviation of a normal distribution with that mean absolute error
    return mean + noise * sigma_min * error_std / torch.sqrt(error_std**2 + sigma_min**2)


class _RepeatedProgress:
    """Reports progress again between the two passes of a guided step, so that it can be
    cancelled there.
    """

    def __init__(self, progress: Progress) -> None:
        self._progress = progress
        self._last_report = (0.0, "")

    def step(self, fraction: float, text: str) -> None:
        """Report; may raise Cancelled."""
        self._last_report = fraction, text
        self.report_again()

    def report_again(self) -> None:
        """Repeat the last report; may raise Cancelled."""
        self._progress.step(*self._last_report)
