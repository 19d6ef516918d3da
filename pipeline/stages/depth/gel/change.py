"""Node *change*: press or drift? Two explanations of the same coarse colour change, compared by
their likelihood.

    drift   dI_c = g_c R_c + b_c + r_c . (u, v) - s . grad R_c      gain, offset and ramp of each
            colour c, shift s
    light   drift, and a smooth field of light, nearly of one colour (a spot, daylight)
    dent    drift, and a_c . grad h, where h is what pressures >= 0 do to the gel (`coarse_light`)

All unknowns have Gaussian priors, so the evidence of each explanation is a closed form in the
eigenvectors of its curvature, which are the same for every frame. The noise is the mean squared
residual: by what the light of an instance differs from the described one counts as noise of either
explanation (MacKay, Information Theory, 2003, chapter 28).

A dent that fills the view looks like drift in each channel, but as drift it is unlikely: ramps of
opposite directions in channels whose LEDs face each other. Beside a dent, drift costs as much as a
coarse light's errors make plausible (`stiffness`), so that it does not take the dent's share.
"""

import math
from collections.abc import Callable
from typing import Literal, NamedTuple, cast

import numpy as np

from pipeline.calibration.markers import detect_markers
from pipeline.core.arrays import Doubles, Floats, Image, Mask, freeze
from pipeline.core.derived import derive_once
from pipeline.core.errors import UNCERTAIN_CONTACT
from pipeline.core.frozen import frozen
from pipeline.core.graph import EarlyAnswer, Skipped
from pipeline.core.progress import Progress
from pipeline.core.values.frames import TactileFrame
from pipeline.core.values.results import DepthMap
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth.frame_checks import make_untouched_depth
from pipeline.stages.depth.gel import coarse_light, drift
from pipeline.stages.depth.gel.coarse_light import DentBasis, DriftPrior
from pipeline.stages.depth.gel.rest import RestState
from pipeline.stages.depth.gel.result import make_gel_depth
from pipeline.stages.depth.gel.settings import CHANGE

Verdict = Literal["press", "none", "uncertain"]


@frozen
class Waves:
    """One kind of change, beside drift, by the eigenvectors of its curvature."""

    columns: Floats  # (n, m) grey
    by_drift: Floats  # (14, m) drift^T columns
    vectors: Floats  # (m, m)
    values: Doubles  # (m,)


@frozen
class ChangeModel:
    """All that is the same for every frame of a reference image in one light."""

    drift: DriftPrior
    light: Waves
    dent: Waves
    dent_curvature: Floats  # (m, m) columns^T columns
    basis: DentBasis


@frozen
class Change:
    """What explains the change of an image."""

    verdict: Verdict
    dent_evidence: float  # nats over drift alone
    light_evidence: float
    dent_mm: Floats  # (rows, cols) of the blocks: indentation, coarse; 0 without a press
    dent_grey: Floats  # (rows, cols, 3) the change that it explains
    load: Floats  # (rows, cols) relative pressure
    # the coarse dent is wide and explains nearly all: no finer surface is better known
    is_smooth: bool = False


@frozen
class ChangeParams:
    """Parameters of the node."""

    contact_limit: float  # times the sensor's smallest indentation


@frozen
class FrameChange:
    """A press, and what the image would be without it."""

    press: Change
    rest: drift.RestImage
    markers: Mask | None  # (rows, cols) what printed markers hide of the image, if there are any


_SMOOTH_DENT = (
    "the touch is smooth and gentle: measured on blocks of the image, by the pressure "
    "that explains it"
)


def detect_press(
    frame: TactileFrame, rest: RestState, params: ChangeParams, progress: Progress
) -> FrameChange | Skipped[DepthMap] | EarlyAnswer[DepthMap]:
    """The press of a frame, and its rest image.

    The depth map where nothing touches, nobody can tell, or all is known.

    All is known of a smooth, gentle dent: no finer surface is better than the coarse one that
    explains it.
    """
    progress.step(0.0, "telling press from drift")
    found = observe_change(cast("Image", frame.image), cast("Image", frame.reference), rest)
    press = found.press
    notes = found.rest.notes
    source = rest.source
    if press.verdict == "none":
        notes = (*notes, drift.describe_no_contact(found.rest))
        return Skipped(output=make_untouched_depth(frame, source, notes), reason=notes[0])
    shape = source.camera.shape
    if press.verdict == "uncertain":
        nothing = np.zeros(shape, np.float32)
        notes = (*notes, UNCERTAIN_CONTACT)
        return EarlyAnswer(output=make_gel_depth(nothing, nothing > 0, frame, rest, notes))
    if press.is_smooth and rest.uses_illumination:
        dent = _upsample_dent(press, shape, params.contact_limit * source.limits.contact_min_mm)
        return EarlyAnswer(output=make_gel_depth(*dent, frame, rest, (*notes, _SMOOTH_DENT)))
    return found


def observe_change(image: Image, reference: Image, rest: RestState) -> FrameChange:
    """Press or drift between two images (rows, cols, 3), and the rest image of the first."""
    still = drift.estimate_rest_image(image, reference)
    exposed = drift.remove_exposure(image, still.exposure)
    printed = rest.source.markers
    markers = None if printed is None else freeze(detect_markers(exposed, printed, rest.pixel_mm))

    def compare(before: Image) -> Floats:
        return coarse_light.compute_block_change(
            exposed, before, printed, rest.pixel_mm, markers
        ).ravel()

    model = _make_model(reference, rest.source, rest.light, rest.pixel_mm)
    press = _explain(compare, reference, still.image_8bit, model)
    if press.is_smooth:
        still = drift.estimate_rest_image(image, reference, press.dent_grey)
    return FrameChange(press=press, rest=still, markers=markers)


def _upsample_dent(press: Change, shape: tuple[int, int], least_mm: float) -> tuple[Floats, Mask]:
    """(indentation in mm, contact) (rows, cols) of a coarse dent: contact is where it is loaded."""
    import cv2

    block = coarse_light.compute_block_px(shape)
    rows, cols = (n * block for n in press.load.shape)
    more = (0, shape[0] - rows, 0, shape[1] - cols)
    indentation, load = (
        cv2.copyMakeBorder(
            cv2.resize(a, (cols, rows), interpolation=cv2.INTER_CUBIC), *more, cv2.BORDER_REPLICATE
        )
        for a in (press.dent_mm, press.load)
    )
    weighted_mean = float((press.load**2).sum() / press.load.sum())
    deep = indentation > max(least_mm, CHANGE.dent_share * float(indentation.max()))
    return np.asarray(indentation, np.float32), (load > CHANGE.load_share * weighted_mean) & deep


def _explain(
    compare: Callable[[Image], Floats], reference: Image, still: Image, model: ChangeModel
) -> Change:
    """What explains the change (n,) of the blocks in grey levels that `compare` returns of an
    image (rows, cols, 3) before it.

    `still`: the reference as most of the image shows it.
    """
    change = compare(reference)
    prior = model.drift
    pull = prior.columns.T @ change
    energy = float(change @ change)
    drift = prior.projection @ pull
    misfit = energy - float(pull @ drift)
    of_dent = model.dent.columns.T @ change
    of_light = model.light.columns.T @ change
    n = change.size
    evidence = _compute_evidence(n, of_dent, model.dent, drift, misfit, CHANGE.pressure_stds)
    light = _compute_evidence(n, of_light, model.light, drift, misfit, CHANGE.light_scales)
    verdict: Verdict = "none"
    fit = None
    cost = float(drift @ prior.precision @ drift) / 2
    if evidence + cost >= CHANGE.none_evidence:
        fit = _fit_dent(change, of_dent, pull, model, CHANGE.stiffness)
        unlikely = max(0.0, cost - float(fit.drift @ prior.precision @ fit.drift) / 2)
        evidence += unlikely
        verdict = decide(evidence, light)
        certain = light >= CHANGE.light_ratio_certain * evidence
        if verdict == "none" and unlikely > CHANGE.unlikely_drift and not certain:
            verdict = "uncertain"
    basis = model.basis
    pressures = np.zeros(basis.heights.shape[-1], np.float32)
    dent_grey = np.zeros(n, np.float32)
    is_smooth = False
    if fit is not None and verdict == "press":
        is_smooth = _is_smooth(fit, basis)
        for before in (still, reference) if is_smooth else ():  # no drift at all is the likeliest
            left = compare(before)
            pulls = model.dent.columns.T @ left, prior.columns.T @ left
            held = _fit_dent(left, *pulls, model, CHANGE.still_stiffness)
            fit = _hold_drift(fit, held)
        pressures, dent_grey, *_ = fit
    return Change(
        verdict=verdict,
        dent_evidence=evidence,
        light_evidence=light,
        dent_mm=freeze(basis.heights @ pressures),
        dent_grey=freeze(dent_grey.reshape(*basis.heights.shape[:2], 3)),
        load=freeze(basis.loads @ pressures),
        is_smooth=is_smooth,
    )


class _DentFit(NamedTuple):
    pressures: Floats  # (m,)
    dent_grey: Floats  # (n,) the change that they explain
    drift: Doubles  # (14,)
    mean_square: float  # grey^2 of the change without the drift
    residual: float  # the same without the dent as well


def _fit_dent(
    change: Floats, of_dent: Floats, pull: Floats, model: ChangeModel, stiffness: float
) -> _DentFit:
    n = change.size
    cost = stiffness * float(change @ change) / n
    pressures, drift = coarse_light.fit_dent(
        of_dent, pull, cost, model.drift, model.dent.by_drift, model.dent_curvature
    )
    left = change - model.drift.columns @ drift
    dent_grey = model.dent.columns @ pressures
    residual = left - dent_grey
    return _DentFit(
        pressures, dent_grey, drift, float(left @ left) / n, float(residual @ residual) / n
    )


def _is_smooth(fit: _DentFit, basis: DentBasis) -> bool:
    if fit.residual >= CHANGE.smooth_residual * fit.mean_square:
        return False
    dent_mm = basis.heights @ fit.pressures
    slopes = basis.slopes @ fit.pressures
    deepest_mm = float(dent_mm.max())
    share = float((dent_mm > 0.5 * deepest_mm).mean())
    radius_mm = math.sqrt(share * dent_mm.size / math.pi) * basis.block_mm
    slope = float(np.hypot(slopes[..., 0], slopes[..., 1]).max())
    least, by_share = CHANGE.smooth_steepness
    return (
        radius_mm > CHANGE.smooth_knots * basis.knot_mm
        and slope < CHANGE.smooth_slope
        and slope * radius_mm < (least + by_share * share) * deepest_mm
    )


def _hold_drift(fit: _DentFit, still: _DentFit) -> _DentFit:
    """The fit with drift held back, as far as that explains the change as well; gradually."""
    floor, (low, high) = CHANGE.floor_grey**2, CHANGE.still_residuals
    ratio = (still.residual + floor) / (fit.residual + floor)
    share = min(max((high - ratio) / (high - low), 0.0), 1.0)
    pressures, dent_grey = (
        np.asarray(share * one + (1 - share) * other, np.float32)
        for one, other in zip(still[:2], fit[:2], strict=True)
    )
    return fit._replace(pressures=pressures, dent_grey=dent_grey)


def decide(dent_evidence: float, light_evidence: float) -> Verdict:
    """The verdict by the evidence of both explanations over drift alone."""
    if (
        dent_evidence < CHANGE.none_evidence
        or light_evidence > CHANGE.light_ratio_none * dent_evidence
    ):
        return "none"
    if (
        dent_evidence < CHANGE.press_evidence
        or light_evidence > CHANGE.light_ratio_press * dent_evidence
    ):
        return "uncertain"
    return "press"


def _compute_evidence(
    n: int,
    of_waves: Floats,
    waves: Waves,
    drift: Doubles,
    misfit: float,
    scales: tuple[float, ...],
) -> float:
    """How much more likely a change (n,) is by waves of the likeliest scale than by drift alone,
    with noise it leaves.

    `of_waves` (m,) is columns^T change; `misfit` is the squared change that the `drift` (14,)
    alone leaves.
    """
    own = waves.vectors.T @ (of_waves - (waves.by_drift.T @ drift).astype(np.float32))
    power = own.astype(np.float64) ** 2
    floor = CHANGE.floor_grey**2
    scale2 = np.square(scales)[:, None]
    noise = np.full(len(scales), misfit / n + floor)
    for _ in range(6):
        explained = (power * scale2 / (noise[:, None] + scale2 * waves.values)).sum(axis=1)
        noise = np.maximum(misfit - explained, 0.0) / n + floor
    occam = np.log1p(scale2 * waves.values / noise[:, None]).sum(axis=1)
    return float((-0.5 * n * np.log(noise / (misfit / n + floor)) - 0.5 * occam).max())


@derive_once
def _make_model(
    reference: Image, source: SensorSpec, light: Floats, pixel_mm: float
) -> ChangeModel:
    """The model of all changes of a reference image (rows, cols, 3)."""
    basis = coarse_light.make_dent_basis(source, pixel_mm)
    drift = coarse_light.make_drift_prior(reference, source, pixel_mm)
    columns = coarse_light.make_dent_columns(light, basis)
    curvature = columns.T @ columns
    return ChangeModel(
        drift=drift,
        light=_make_light_waves(light.shape[0], light.shape[1], drift),
        dent=_diagonalise(columns, curvature, drift),
        dent_curvature=freeze(curvature),
        basis=basis,
    )


def _diagonalise(columns: Floats, curvature: Floats, drift: DriftPrior) -> Waves:
    by_drift = drift.columns.T @ columns
    values, vectors = np.linalg.eigh(
        curvature - by_drift.T @ (drift.projection @ by_drift).astype(np.float32)
    )
    return Waves(
        columns=columns,
        by_drift=freeze(by_drift),
        vectors=freeze(vectors),
        values=freeze(np.maximum(values, 0.0).astype(np.float64)),
    )


def _make_light_waves(rows: int, cols: int, drift: DriftPrior) -> Waves:
    """Smooth fields of light, each wave in three orthogonal colours, in units of their prior."""
    y, x = (np.pi * (np.arange(n) + 0.5) / n for n in (rows, cols))
    mixture = np.linalg.cholesky(coarse_light.correlate_colours(CHANGE.light_common_share))
    n = CHANGE.light_waves
    fields = [
        np.outer(np.cos(i * y), np.cos(j * x))[..., None, None]
        * (CHANGE.light_std / np.hypot(i, j) * mixture)
        for i in range(n)
        for j in range(n - i)
        if i or j
    ]
    columns = np.concatenate(fields, -1).reshape(-1, 3 * len(fields)).astype(np.float32)
    return _diagonalise(freeze(columns), columns.T @ columns, drift)
