"""Candidate calibration tables from presses, weakest correction first, and their cross-validation.

The built-in table; the table of the shading field fitted to the presses (`shading_field`); and that
table plus a polynomial of the remaining slope errors with a ridge penalty, which needs more than a
few presses.

The depth stage without calibration may be better than the built-in table. It is the baseline
(`SlopeReader`), and a correction must beat it significantly, press by press or by a wide margin.

The expected error of a table is predicted, then corrected by held-out presses. The posterior of the
shading field predicts the error anywhere in the image, also far from presses: virtual presses of
the ball on a grid are rendered under sampled fields and measured with the table. Held-out presses
measure the error where presses are, with everything that the field does not model: inexact circles,
other reflectance.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from pipeline.calibration import shading_field, slope_model
from pipeline.calibration.ball_presses import (
    BallPress,
    BallSlopeProfile,
    gather_contact_slopes,
    sample_contact,
    sample_presses,
    sample_surface,
)
from pipeline.calibration.calibration_table import P90_OVER_STD, USUAL_STD, ExpectedError
from pipeline.calibration.shading_field import ShadingFieldPrior
from pipeline.calibration.slope_model import SlopeModel, SlopeSamples
from pipeline.core.arrays import Doubles, Floats, Mask, freeze

# shading fields and pixels that a table is fitted to
_DRAWS = 40
_PIXELS = 8000
_QUICK_PIXELS = 4000  # while the circles are refined
_RIDGES = (1e-2, 3e-4)  # of the polynomial, strongest first
_POSITION_DEGREE = 2  # of the polynomial: less than the table's, which the field determines
_POLYNOMIAL_PRESSES_MIN = 8  # presses
_FOLDS = 6
_SIMPLER_FACTOR = 1.02  # a simpler table is taken if its error is within this factor of the best
# relative standard deviation of the median size of n normal errors, times sqrt(n)
_MEDIAN_STD = 1.17
_SPHERE_PIXELS_MIN = 12  # pixels that a sphere is fitted to
_ERROR_MAX = 1.0  # error of a ball that is not detected
_SIGNIFICANCE = 2.0  # standard deviations by which a correction must beat the baseline

SlopeReader = Callable[
    [int], tuple[Floats, Floats]
]  # image index -> slopes (gx, gy), each (rows, cols), without calibration


@dataclass(frozen=True, slots=True, kw_only=True)
class PressSet:
    """Presses and priors that corrections are fitted to."""

    presses: tuple[BallPress, ...]
    ball: BallSlopeProfile
    pixel_mm: float
    prior: ShadingFieldPrior
    built_in: SlopeModel
    seed: int  # of the pixel samples

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols) of the images."""
        rows, cols = self.presses[0].change.shape[:2]
        return rows, cols

    def drop_presses(self, indices: set[int]) -> PressSet:
        """The set without the presses at these positions."""
        return replace(
            self, presses=tuple(p for i, p in enumerate(self.presses) if i not in indices)
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class HeldOutErrors:
    """Errors of the corrections on held-out presses: one row per press, one column per
    correction.
    """

    slope_rms: Doubles  # rms error, mm/mm
    diameter_share: Doubles  # (measured diameter - true) / true


def fit_field(known: PressSet) -> ShadingFieldPrior:
    """The shading field fitted to the presses."""
    rng = np.random.default_rng(known.seed)
    return shading_field.update_field(
        known.prior, [sample_surface(p, known.ball, known.pixel_mm, rng) for p in known.presses]
    )


def fit_quick_table(known: PressSet) -> SlopeModel:
    """The table of the posterior mean of the shading field."""
    fields = fit_field(known)
    return shading_field.fit_slope_model(
        fields.mean[None], known.shape, _QUICK_PIXELS, np.random.default_rng(known.seed)
    )


def fit_candidates(
    known: PressSet, *, polynomials: bool
) -> tuple[list[SlopeModel], ShadingFieldPrior]:
    """All candidate tables, the built-in one first, and the shading field that they use."""
    rng = np.random.default_rng(known.seed)
    fields = fit_field(known)
    base = shading_field.fit_slope_model(
        shading_field.sample_fields(fields, _DRAWS, rng), known.shape, _PIXELS, rng
    )
    models = [known.built_in, base]
    if polynomials:
        samples, weights = sample_presses(known.presses, known.ball, rng)
        left = replace(samples, slopes=samples.slopes - slope_model.predict(base, samples))
        for ridge in _RIDGES:
            more = slope_model.fit(
                left,
                weights,
                colour_degree=base.colour_degree,
                position_degree=_POSITION_DEGREE,
                ridge=ridge,
            )
            wider = base.position_degree - _POSITION_DEGREE
            table = np.pad(more.coefficients, ((0, wider), (0, wider), (0, 0), (0, 0)))
            models.append(replace(base, coefficients=freeze(base.coefficients + table)))
    return models, fields


def has_enough_for_polynomials(n_presses: int) -> bool:
    """Whether these are enough presses for a polynomial."""
    return n_presses >= _POLYNOMIAL_PRESSES_MIN


def cross_validate(known: PressSet, step: Callable[[float], None]) -> HeldOutErrors | None:
    """Errors of every press with tables fitted to the others; None if there is only one."""
    n = len(known.presses)
    if n < 2:
        return None
    folds = np.array_split(np.random.default_rng(known.seed).permutation(n), min(n, _FOLDS))
    rows: dict[int, tuple[list[float], list[float]]] = {}
    for done, fold in enumerate(folds):
        out = {int(i) for i in fold}
        models, _ = fit_candidates(
            known.drop_presses(out), polynomials=has_enough_for_polynomials(n)
        )
        for i in out:
            samples = sample_contact(known.presses[i], known.ball)
            rows[i] = (
                [compute_slope_error(m, samples) for m in models],
                [measure_diameter_error(slope_model.predict(m, samples), samples) for m in models],
            )
        step((done + 1) / len(folds))
    return HeldOutErrors(
        slope_rms=np.array([rows[i][0] for i in range(n)]),
        diameter_share=np.array([rows[i][1] for i in range(n)]),
    )


def choose_candidate(held: HeldOutErrors | None) -> int:
    """Index of the simplest correction that is nearly the best on held-out presses.

    0 = the built-in table.

    A correction whose product of slope and diameter error exceeds the built-in table's is excluded:
    the diameters of a few presses may be right by chance, and slightly better slopes may give a
    worse diameter. A single press cannot be held out: its correction is taken.
    """
    if held is None:
        return 1
    diameters = np.median(np.nan_to_num(np.abs(held.diameter_share), nan=1.0), axis=0)
    errors = held.slope_rms.mean(axis=0)
    errors = np.where(errors * diameters <= errors[0] * diameters[0], errors, np.inf)
    return int(np.flatnonzero(errors <= _SIMPLER_FACTOR * errors.min())[0])


def measure_uncalibrated_errors(known: PressSet, read: SlopeReader) -> Doubles:
    """Relative diameter errors of the presses without calibration; NaN = no ball detected."""
    return np.array(
        [
            measure_diameter_error(
                gather_contact_slopes(p, *read(p.index)), sample_contact(p, known.ball)
            )
            for p in known.presses
        ]
    )


def clip_errors(errors: Doubles) -> Doubles:
    """Diameter errors, limited to that of a ball that is not detected."""
    return np.asarray(np.minimum(np.nan_to_num(errors, nan=_ERROR_MAX), _ERROR_MAX), np.float64)


def is_significantly_better(share: float, without: Doubles, held: Doubles) -> bool:
    """Whether a correction with expected diameter error `share` is significantly better than errors
    `without` any.

    `held`: its errors on the same presses when held out, or empty. They must be smaller press by
    press (Wilcoxon's signed-rank test), or smaller in the median by more than its uncertainty.
    Ranks of four presses are never significant.
    """
    n = len(without)
    median = float(np.median(np.abs(without)))
    if share >= median:
        return False
    by_far = share * math.exp(_SIGNIFICANCE * math.sqrt(2.0) * _MEDIAN_STD / math.sqrt(n)) < median
    if by_far or len(held) != n:
        return by_far
    gain = np.abs(without) - np.minimum(np.nan_to_num(np.abs(held), nan=_ERROR_MAX), _ERROR_MAX)
    ranks = np.empty(n)
    ranks[np.argsort(np.abs(gain), kind="stable")] = np.arange(1, n + 1)
    deviation = math.sqrt(n * (n + 1) * (2 * n + 1) / 6.0)
    return float((np.sign(gain) * ranks).sum()) > _SIGNIFICANCE * deviation


def compute_slope_error(model: SlopeModel, samples: SlopeSamples) -> float:
    """Rms slope error, mm/mm; infinite without pixels."""
    if len(samples.u) == 0:
        return float("inf")
    return float(np.sqrt(np.mean((slope_model.predict(model, samples) - samples.slopes) ** 2)))


def measure_diameter_error(slopes: Floats, samples: SlopeSamples) -> float:
    """Relative error of the diameter of the sphere fitted to slopes (n, 2) at samples.

    NaN with too few of them.
    """
    return (
        compute_sphere_error(slopes, samples.slopes)
        if len(slopes) >= _SPHERE_PIXELS_MIN
        else float("nan")
    )


def compute_sphere_error(slopes: Floats | Doubles, true: Floats | Doubles) -> float:
    """Relative error of the radius of the sphere fitted to slopes (n, 2)."""
    normal, wanted = (g / np.sqrt(1.0 + (g**2).sum(axis=1, keepdims=True)) for g in (slopes, true))
    normal = normal - normal.mean(axis=0)
    wanted = wanted - wanted.mean(axis=0)
    curvature = float((normal * wanted).sum() / (wanted**2).sum())  # over the true one
    return 1.0 / max(curvature, 0.05) - 1.0


_VIRTUAL_DRAWS = 12
_GRID = (5, 6)  # virtual presses, down and across
_COVERAGE_GRID = 24  # points along each side, for the share that presses cover
_MARGIN = 0.1  # of the image: no table measures touches at its very border well
_VIRTUAL_PIXELS = 60  # of a virtual press
# half-widths of the image from a press: within this, light correlates by three quarters
_NEAR_SHARE = 0.5
_PRIOR_PRESSES = 4.0  # presses that the prediction counts as
# on the prediction: inexact circles and light that the field does not model
_PREDICTION_FACTOR = 2.0
_ERROR_FLOOR = 0.03  # uncertainty of the contact's edge, however many presses: forty of a real Mini
_MEDIAN_MIN = 0.005  # smaller medians of a few errors are chance
_COVERAGE_MIN = 0.5  # of the image: with less, the error elsewhere is unknown
_PERCENTILES = (50.0, 90.0)  # that are stated
_STD_OVER_MEAN = 1.253  # standard deviation of normal errors over the mean of their sizes
# of the sizes of normal errors; the mean of a few is more certain by a third
_MEDIAN_OVER_MEAN = 0.845


def simulate_errors(model: SlopeModel, fields: ShadingFieldPrior, known: PressSet) -> Doubles:
    """Relative diameter errors of virtual presses of the ball: (draws, places)."""
    rng = np.random.default_rng(1)
    rows, cols = known.shape
    ball_px = known.ball.radius_px
    contact_px = float(np.median([p.circle.radius_px for p in known.presses]))
    u_all, v_all = slope_model.compute_positions(known.shape)
    y, x = (
        np.linspace(_MARGIN * (n - 1), (1 - _MARGIN) * (n - 1), k)
        for n, k in zip((rows, cols), _GRID, strict=True)
    )
    r = contact_px * np.sqrt(rng.random(_VIRTUAL_PIXELS))
    turn = rng.uniform(0.0, 2.0 * math.pi, _VIRTUAL_PIXELS)
    dx = r * np.cos(turn)
    dy = r * np.sin(turn)
    slopes = -np.stack([dx, dy], axis=1) / np.sqrt(ball_px**2 - r**2)[:, None]
    parts = shading_field.compute_shading_terms(
        slopes, (contact_px**2 - 0.5 * r**2) / ball_px * known.pixel_mm
    )
    unit = float(u_all[1] - u_all[0])
    out = np.empty((_VIRTUAL_DRAWS, len(y) * len(x)))
    candidates = shading_field.sample_fields(fields, _VIRTUAL_DRAWS, rng)
    for place, (cy, cx) in enumerate((a, b) for a in y for b in x):
        u = (u_all[0] + unit * (cx + dx)).astype(np.float32)
        v = (v_all[0] + unit * (cy + dy)).astype(np.float32)
        at = shading_field.compute_position_terms(u, v)
        for k, candidate in enumerate(candidates):
            seen = shading_field.predict_colours(candidate, at, parts).astype(np.float32)
            measured = slope_model.predict(
                model, SlopeSamples(change=seen, u=u, v=v, slopes=slopes.astype(np.float32))
            )
            out[k, place] = compute_sphere_error(measured, slopes)
    return out


def estimate_expected_error(
    virtual: Doubles, held: HeldOutErrors | None, best: int
) -> ExpectedError:
    """The expected error of correction number `best` over the image.

    `virtual`: its errors of `simulate_errors`.
    """
    virtual = virtual.ravel()
    measured = np.array([]) if held is None else held.diameter_share[:, best]
    measured = measured[np.isfinite(measured)]
    # The indentation of a ball of known size is proportional to the measured curvature.
    virtual_depth, measured_depth = (1.0 / (1.0 + errors) - 1.0 for errors in (virtual, measured))
    diameter, depth = (
        [_combine_errors(np.abs(predicted), np.abs(held_out), percent) for percent in _PERCENTILES]
        for predicted, held_out in ((virtual, measured), (virtual_depth, measured_depth))
    )
    return ExpectedError(
        diameter_share=diameter[0],
        diameter_p90=diameter[1],
        depth_share=depth[0],
        depth_p90=depth[1],
        n_held_out=len(measured),
    )


def compute_coverage_map(virtual: Doubles, known: PressSet) -> Mask:
    """Places (down, across) that the presses cover: one is near, and a virtual ball there is
    detected.
    """
    rows, cols = known.shape
    down, across = (
        np.linspace(_MARGIN * n, (1 - _MARGIN) * n, k)
        for n, k in zip((rows, cols), _GRID, strict=True)
    )
    seen = np.median(np.abs(virtual), axis=0).reshape(_GRID) < 1.0
    return freeze(np.asarray(seen & _is_near_press(known, *np.meshgrid(across, down)), np.bool_))


def has_low_coverage(known: PressSet) -> bool:
    """Whether too little of the image is near a press; elsewhere the shading field is a guess."""
    rows, cols = known.shape
    x, y = np.meshgrid(
        np.arange(0.5, _COVERAGE_GRID) / _COVERAGE_GRID * cols,
        np.arange(0.5, _COVERAGE_GRID) / _COVERAGE_GRID * rows,
    )
    return float(_is_near_press(known, x, y).mean()) < _COVERAGE_MIN


def _is_near_press(known: PressSet, x_px: Doubles, y_px: Doubles) -> Mask:
    away = np.min(
        [np.hypot(x_px - p.circle.x_px, y_px - p.circle.y_px) for p in known.presses], axis=0
    )
    return np.asarray(away < _NEAR_SHARE * 0.5 * max(known.shape), np.bool_)


def summarise_errors(errors: Doubles) -> ExpectedError:
    """The expected error of a table that is independent of the presses, from their relative
    diameter `errors`.
    """

    def estimate_median(sizes: Doubles) -> float:
        return max(_MEDIAN_OVER_MEAN * float(np.abs(sizes).mean()), _MEDIAN_MIN)

    def estimate_p90(sizes: Doubles) -> float:
        n = len(sizes)  # few presses seldom include the largest errors
        mean = _STD_OVER_MEAN * float(np.abs(sizes).sum())
        return P90_OVER_STD * (_PRIOR_PRESSES * USUAL_STD + mean) / (_PRIOR_PRESSES + n)

    depth = 1.0 / (1.0 + errors) - 1.0
    return ExpectedError(
        diameter_share=estimate_median(errors),
        diameter_p90=estimate_p90(errors),
        depth_share=estimate_median(depth),
        depth_p90=estimate_p90(depth),
        n_held_out=len(errors),
    )


def _combine_errors(virtual: Doubles, measured: Doubles, percent: float) -> float:
    """Weighted log mean of a percentile of predicted and measured errors: more presses, more
    weight of the measured.
    """
    before = math.log(_PREDICTION_FACTOR * float(np.percentile(virtual, percent)))
    if len(measured) == 0:
        return math.hypot(math.exp(before), _ERROR_FLOOR)
    after = math.log(max(float(np.percentile(measured, percent)), _MEDIAN_MIN))
    return math.hypot(
        math.exp(
            (_PRIOR_PRESSES * before + len(measured) * after) / (_PRIOR_PRESSES + len(measured))
        ),
        _ERROR_FLOOR,
    )
