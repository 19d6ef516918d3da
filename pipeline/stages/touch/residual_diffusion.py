"""Sampling of the residual between a prior estimate and the true touch, for the diffusion methods.

One step gives the posterior mean, the best single estimate; four and more steps give a sample of
the posterior. No step leaves the prior unchanged.

Below the smallest training noise nothing is sampled: the last network output is the mean over all
fields that differ by less, and samples would lack that variance. It is added by one ancestral step
(Ho et al. 2020, see `sample_below_sigma_min`) from the predicted error: a field of standard
deviation s observed through noise n is known to n s / sqrt(n^2 + s^2). A gel's image shows slopes,
in which such noise exceeds any touch: its samples end with the mean.

Renders a membrane with a correction as the touch that the target sensor would record.

Confidence weighting: shrinks a network's correction toward physics, pixel by pixel, where its
error is large.

A correction as large as its expected error is taken by half, a much larger one almost completely.
The expected error is trained on held-out touches and calibrated on others, separately inside and
outside the source's view: on new objects a network is over-confident. Predicted errors can also be
too uniform (small ones too large, large ones too small), so that weights carry an exponent besides
the factors.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from pipeline.core.arrays import Floats, Image, Mask, freeze
from pipeline.core.errors import ChangeNote, OutsideViewWarning
from pipeline.core.frozen import frozen
from pipeline.core.graph import Fallback
from pipeline.core.params import setting
from pipeline.core.progress import SILENT, Progress
from pipeline.core.values.results import DepthMap, GeneratedTouch, TouchStep
from pipeline.physics.sensor_images import render_sensor_image
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.networks.network_factory import reproducible_inference
from pipeline.stages.networks.onnx_predictor import FIELD_LIMIT, FirstPassPredictor, ResidualNetwork
from pipeline.stages.networks.samplers import (
    GUIDED_STEPS,
    MAX_STEPS,
    MAX_WEIGHT,
    SOLVERS,
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


@frozen
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
        choices=SOLVERS,
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


@frozen
class DenoisingState:
    """The expected clean residual at one step, each field (rows, cols)."""

    sigma: float  # noise level, in `unit_mm`
    residual_mm: Floats
    contact_correction: Floats  # added to the contact of the prior


@frozen
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


_HALF = 0.5
NO_STEPS = "physics: no denoising step"
NO_PRIOR_CONTACT = "physics: the render has no contact that the network could correct"
NO_CHANGE = (
    "physics: the network changes nothing; its corrections are smaller than their expected errors"
)


def render_correction(
    first: GeneratedTouch, target: SensorSpec, sample: ResidualSample, seed: int | None
) -> GeneratedTouch:
    """`first` with a sample's correction, resampled from the working grid to the target's pixels.

    The membrane is limited to the sensor's maximum indentation. `seed` sets the sensor noise, None
    = no noise. The whole image is in view; `membrane.expected_error_mm` holds the uncertainty.
    Warnings of what physics leaves out are dropped.
    """
    prior_membrane = first.membrane
    assert prior_membrane is not None
    error_mm = freeze(_resize(sample.expected_error_mm, target.camera.shape))
    image, corrected = _render_state(prior_membrane, target, sample.final, seed)
    steps = [
        TouchStep(image=rendered, sigma=state.sigma, membrane=membrane)
        for state in sample.states
        for rendered, membrane in (_render_state(prior_membrane, target, state, None),)
    ]
    return replace(
        first,
        image=image,
        membrane=replace(corrected, expected_error_mm=error_mm),
        in_view=freeze(np.ones(target.camera.shape, np.bool_)),
        notes=(
            *(note for note in first.notes if not isinstance(note, OutsideViewWarning)),
            *sample.notes,
        ),
        steps=tuple(steps),
    )


def _render_state(
    first: DepthMap, target: SensorSpec, state: DenoisingState, seed: int | None
) -> tuple[Image | Floats, DepthMap]:
    shape = target.camera.shape
    surface = first.indentation_mm + _resize(state.residual_mm, shape)
    surface = np.minimum(surface, np.float32(target.limits.indentation_max_mm)).astype(np.float32)
    contact: Mask = (
        first.contact.astype(np.float32) + _resize(state.contact_correction, shape) > _HALF
    )
    depth: Floats = (target.rest_depth_mm - surface).astype(np.float32)
    corrected = replace(
        first,
        indentation_mm=freeze(surface),
        depth_mm=freeze(depth),
        contact=freeze(contact),
        is_generated=True,
    )
    return render_sensor_image(target, surface, depth, seed), corrected


def report_change(
    touch: GeneratedTouch, physical: GeneratedTouch
) -> GeneratedTouch | Fallback[GeneratedTouch]:
    """`touch` with a note of what the network changed.

    A fallback where image and contact equal those of physics.

    The note holds the mean distance from physics in contact, or the number of pixels where only the
    contact differs.
    """
    assert touch.membrane is not None
    assert physical.membrane is not None
    n_contact_changes = np.count_nonzero(touch.membrane.contact != physical.membrane.contact)
    if np.array_equal(touch.image, physical.image):
        if not n_contact_changes:
            notes = tuple(dict.fromkeys((*physical.notes, *touch.notes)))
            return Fallback(result=replace(physical, notes=notes), reason=NO_CHANGE)
        return replace(
            touch,
            notes=(
                *touch.notes,
                ChangeNote(f"network correction: {n_contact_changes} px of the contact"),
            ),
        )
    contact = touch.membrane.contact | physical.membrane.contact
    change_mm = np.abs(touch.membrane.indentation_mm - physical.membrane.indentation_mm)[contact]
    note = ChangeNote(
        f"network correction: {float(change_mm.mean()) if change_mm.size else 0.0:.2g} mm"
    )
    return replace(touch, notes=(*touch.notes, note))


def resample_to_grid(field: Floats | Mask, shape: tuple[int, int]) -> Floats:
    """A field as area means on a coarser grid of the same view."""
    import cv2

    whole = np.asarray(field, np.float32)
    if whole.shape == shape:
        return whole
    return np.asarray(cv2.resize(whole, shape[::-1], interpolation=cv2.INTER_AREA), np.float32)


def _resize(field: Floats, shape: tuple[int, int]) -> Floats:
    import cv2

    if field.shape == shape:
        return np.asarray(field, np.float32)
    return np.asarray(
        cv2.resize(np.array(field), shape[::-1], interpolation=cv2.INTER_LINEAR), np.float32
    )


_BLUR_PX = 4.0  # px; a share with finer structure would create edges


@frozen
class ErrorCalibration:
    """Calibration of a network's predicted error."""

    factor_in_view: float  # factor of the predicted error inside the source's view
    factor_outside: float
    exponent: float = 1.0  # exponent of that error, in `unit_mm`
    unit_mm: float = 1.0

    def calibrate_error_mm(self, predicted_error_mm: Floats, in_view: Mask) -> Floats:
        """Expected error (rows, cols) for a predicted error."""
        factor = np.where(in_view, np.float32(self.factor_in_view), np.float32(self.factor_outside))
        return (
            factor
            * predicted_error_mm
            * (predicted_error_mm / np.float32(self.unit_mm)) ** np.float32(self.exponent - 1.0)
        ).astype(np.float32)


def read_error_calibration(network: Any) -> ErrorCalibration:
    """The calibration in the weights of a `residual_denoiser`."""
    in_view_factor, outside_factor = network.error_factors
    return ErrorCalibration(
        factor_in_view=in_view_factor,
        factor_outside=outside_factor,
        exponent=network.error_exponent,
        unit_mm=network.unit_mm,
    )


def shrink_to_prior(
    sample: ResidualSample,
    in_view: Mask,
    confidence_weighting: float,
    calibration: ErrorCalibration,
    *,
    shrinks_contact: bool = True,
) -> ResidualSample:
    """Shrink a posterior mean toward physics; `in_view` is where the source sees.

    `confidence_weighting` 0 keeps the full correction, 1 applies the whole Wiener gain. Contact is
    shrunk as the membrane in view, and by the root of the share outside, where nothing else is
    known (overlap 0.473 instead of 0.460 without shrinking, on 160 touches outside the tables).
    Without `shrinks_contact` the prior's contact is kept in view.
    """
    mean = sample.final.residual_mm
    spread = sample.expected_error_mm
    is_in_view = resample_to_grid(in_view, mean.shape) > _HALF
    share = 1.0 - confidence_weighting * (
        1.0 - compute_wiener_gain(mean, calibration.calibrate_error_mm(spread, is_in_view))
    )
    contact_share = np.where(
        is_in_view,
        share if shrinks_contact else np.float32(1.0 - confidence_weighting),
        np.sqrt(share),
    )

    def shrink_state(state: DenoisingState) -> DenoisingState:
        residual = (share * state.residual_mm).astype(np.float32)
        return replace(
            state,
            residual_mm=freeze(residual),
            contact_correction=freeze(
                (contact_share * state.contact_correction).astype(np.float32)
            ),
        )

    return replace(
        sample,
        final=shrink_state(sample.final),
        states=tuple(shrink_state(state) for state in sample.states),
    )


def compute_wiener_gain(correction_mm: Floats, error_mm: Floats) -> Floats:
    """Share 0..1 (rows, cols) of a correction with this expected error: m^2 / (m^2 + s^2),
    smoothed.
    """
    signal, noise = (_blur(np.square(f, dtype=np.float32)) for f in (correction_mm, error_mm))
    return np.where(
        noise > 0.0, signal / np.maximum(signal + noise, np.float32(1e-12)), np.float32(1.0)
    )


def _blur(field: Floats) -> Floats:
    import cv2

    return np.asarray(cv2.GaussianBlur(field, (0, 0), _BLUR_PX), np.float32)
