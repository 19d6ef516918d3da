"""Candidate calibration tables from presses, weakest correction first, and their cross-validation.

The built-in table; the table of the shading field fitted to the presses (`shading_field`); and that table plus a
polynomial of the remaining slope errors with a ridge penalty, which needs more than a few presses.

The depth stage without calibration may be better than the built-in table. It is the baseline (`SlopeReader`), and a
correction must beat it significantly, press by press or by a wide margin.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from pipeline.base.arrays import Doubles, Floats, freeze
from pipeline.calibration import shading_field, slope_model
from pipeline.calibration.ball_samples import gather_contact_slopes, sample_contact, sample_presses, sample_surface
from pipeline.calibration.ball_slopes import BallPress, BallSlopeProfile
from pipeline.calibration.shading_field import ShadingFieldPrior
from pipeline.calibration.slope_model import SlopeModel, SlopeSamples

_DRAWS, _PIXELS = 40, 8000  # shading fields and pixels that a table is fitted to
_QUICK_PIXELS = 4000  # while the circles are refined
_RIDGES = (1e-2, 3e-4)  # of the polynomial, strongest first
_POSITION_DEGREE = 2  # of the polynomial: less than the table's, which the field determines
_POLYNOMIAL_PRESSES_MIN = 8  # presses
_FOLDS = 6
_SIMPLER_FACTOR = 1.02  # a simpler table is taken if its error is within this factor of the best
_MEDIAN_STD = 1.17  # relative standard deviation of the median size of n normal errors, times sqrt(n)
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
        return replace(self, presses=tuple(p for i, p in enumerate(self.presses) if i not in indices))


@dataclass(frozen=True, slots=True, kw_only=True)
class HeldOutErrors:
    """Errors of the corrections on held-out presses: one row per press, one column per correction."""

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


def fit_candidates(known: PressSet, *, polynomials: bool) -> tuple[list[SlopeModel], ShadingFieldPrior]:
    """All candidate tables, the built-in one first, and the shading field that they use."""
    rng = np.random.default_rng(known.seed)
    fields = fit_field(known)
    base = shading_field.fit_slope_model(shading_field.sample_fields(fields, _DRAWS, rng), known.shape, _PIXELS, rng)
    models = [known.built_in, base]
    if polynomials:
        samples, weights = sample_presses(known.presses, known.ball, rng)
        left = replace(samples, slopes=samples.slopes - slope_model.predict(base, samples))
        for ridge in _RIDGES:
            more = slope_model.fit(left, weights, colour_degree=base.colour_degree, position_degree=_POSITION_DEGREE,
                                   ridge=ridge)  # fmt: skip
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
        models, _ = fit_candidates(known.drop_presses(out), polynomials=has_enough_for_polynomials(n))
        for i in out:
            samples = sample_contact(known.presses[i], known.ball)
            rows[i] = (
                [compute_slope_error(m, samples) for m in models],
                [measure_diameter_error(slope_model.predict(m, samples), samples) for m in models],
            )
        step((done + 1) / len(folds))
    return HeldOutErrors(
        slope_rms=np.array([rows[i][0] for i in range(n)]), diameter_share=np.array([rows[i][1] for i in range(n)])
    )


def choose_candidate(held: HeldOutErrors | None) -> int:
    """Index of the simplest correction that is nearly the best on held-out presses; 0 = the built-in table.

    A correction whose product of slope and diameter error exceeds the built-in table's is excluded: the diameters of a
    few presses may be right by chance, and slightly better slopes may give a worse diameter. A single press cannot be
    held out: its correction is taken.
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
            measure_diameter_error(gather_contact_slopes(p, *read(p.index)), sample_contact(p, known.ball))
            for p in known.presses
        ]
    )


def clip_errors(errors: Doubles) -> Doubles:
    """Diameter errors, limited to that of a ball that is not detected."""
    return np.asarray(np.minimum(np.nan_to_num(errors, nan=_ERROR_MAX), _ERROR_MAX), np.float64)


def is_significantly_better(share: float, without: Doubles, held: Doubles) -> bool:
    """Whether a correction with expected diameter error `share` is significantly better than errors `without` any.

    `held`: its errors on the same presses when held out, or empty. They must be smaller press by press (Wilcoxon's
    signed-rank test), or smaller in the median by more than its uncertainty. Ranks of four presses are never
    significant.
    """
    n, median = len(without), float(np.median(np.abs(without)))
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
    """Relative error of the diameter of the sphere fitted to slopes (n, 2) at samples; NaN with too few of them."""
    return compute_sphere_error(slopes, samples.slopes) if len(slopes) >= _SPHERE_PIXELS_MIN else float("nan")


def compute_sphere_error(slopes: Floats | Doubles, true: Floats | Doubles) -> float:
    """Relative error of the radius of the sphere fitted to slopes (n, 2)."""
    normal, wanted = (g / np.sqrt(1.0 + (g**2).sum(axis=1, keepdims=True)) for g in (slopes, true))
    normal, wanted = normal - normal.mean(axis=0), wanted - wanted.mean(axis=0)
    curvature = float((normal * wanted).sum() / (wanted**2).sum())  # over the true one
    return 1.0 / max(curvature, 0.05) - 1.0
