"""Look-ups that presses can give, weakest correction first, and which of them holds for presses it has not seen.

The built-in look-up; the one of the field of light that the presses leave (`light_field`); and that one plus a
polynomial of what it leaves of the slopes, held back by a ridge. A few presses are not enough for the polynomial.

Whoever reads pictures without a calibration may do better than the built-in look-up alone. He is asked what he reads
(`Read`), and a correction has to better that surely, press for press or by far.
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

_DRAWS, _PIXELS = 40, 8000  # fields and pixels that a look-up is made from
_QUICK_PIXELS = 4000  # while the circles are still moving
_RIDGES = (1e-2, 3e-4)  # of the polynomial, strongest first
_PLACE_DEGREE = 2  # of the polynomial: less than the look-up's, which the field has settled
_ENOUGH = 8  # presses for a polynomial
_FOLDS = 6
_BEST_WITHIN = 1.02  # a simpler look-up is taken if it is as good as this times the best
_MEDIAN_UNSURE = 1.17  # standard deviation of the median size of n normal errors, over itself, times sqrt(n)
_FEWEST_PX = 12  # that a sphere is told from
_UNSEEN = 1.0  # error of a ball that is not seen at all
_SURE = 2.0  # standard deviations by which a correction has to be better than none

SlopeReader = Callable[
    [int], tuple[Floats, Floats]
]  # slopes (rows, cols) that are read of a picture, without calibration


@dataclass(frozen=True, slots=True, kw_only=True)
class PressSet:
    """What corrections are made from."""

    presses: tuple[BallPress, ...]
    ball: BallSlopeProfile
    pixel_mm: float
    prior: ShadingFieldPrior
    built_in: SlopeModel
    seed: int  # of the pixels that are looked at

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the pictures."""
        rows, cols = self.presses[0].change.shape[:2]
        return rows, cols

    def drop_presses(self, indices: set[int]) -> PressSet:
        """All but some."""
        return replace(self, presses=tuple(p for i, p in enumerate(self.presses) if i not in indices))


@dataclass(frozen=True, slots=True, kw_only=True)
class HeldOutErrors:
    """How the corrections do on presses that they have not seen, one row a press, one column a correction."""

    slope_rms: Doubles  # rms error, mm/mm
    diameter_share: Doubles  # of the ball, less its own, over its own


def fit_field(known: PressSet) -> ShadingFieldPrior:
    """The field of light after the presses."""
    rng = np.random.default_rng(known.seed)
    return shading_field.update_field(
        known.prior, [sample_surface(p, known.ball, known.pixel_mm, rng) for p in known.presses]
    )


def fit_quick_table(known: PressSet) -> SlopeModel:
    """The look-up of the likeliest field."""
    fields = fit_field(known)
    return shading_field.fit_slope_model(
        fields.mean[None], known.shape, _QUICK_PIXELS, np.random.default_rng(known.seed)
    )


def fit_candidates(known: PressSet, *, polynomials: bool) -> tuple[list[SlopeModel], ShadingFieldPrior]:
    """All look-ups, the built-in one first, and the field that they rest on."""
    rng = np.random.default_rng(known.seed)
    fields = fit_field(known)
    base = shading_field.fit_slope_model(shading_field.sample_fields(fields, _DRAWS, rng), known.shape, _PIXELS, rng)
    models = [known.built_in, base]
    if polynomials:
        samples, weights = sample_presses(known.presses, known.ball, rng)
        left = replace(samples, slopes=samples.slopes - slope_model.predict(base, samples))
        for ridge in _RIDGES:
            more = slope_model.fit(left, weights, colour_degree=base.colour_degree, position_degree=_PLACE_DEGREE,
                                   ridge=ridge)  # fmt: skip
            wider = base.position_degree - _PLACE_DEGREE
            table = np.pad(more.coefficients, ((0, wider), (0, wider), (0, 0), (0, 0)))
            models.append(replace(base, coefficients=freeze(base.coefficients + table)))
    return models, fields


def has_enough_for_polynomials(n_presses: int) -> bool:
    """Whether so many presses can settle a polynomial."""
    return n_presses >= _ENOUGH


def cross_validate(known: PressSet, step: Callable[[float], None]) -> HeldOutErrors | None:
    """Every press measured with the look-ups of the others; None if there is only one."""
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
                [compute_diameter_error(m, samples) for m in models],
            )
        step((done + 1) / len(folds))
    return HeldOutErrors(
        slope_rms=np.array([rows[i][0] for i in range(n)]), diameter_share=np.array([rows[i][1] for i in range(n)])
    )


def choose_candidate(held: HeldOutErrors | None) -> int:
    """The simplest correction that is nearly the best for presses that it has not seen; 0 = the built-in look-up.

    One that is worse than the built-in look-up in slopes times diameters is none: the diameters of a few presses may be
    right by luck, and slopes that are a little better may bend a ball worse. A single press can be held out from
    nothing: its correction is taken.
    """
    if held is None:
        return 1
    diameters = np.median(np.nan_to_num(np.abs(held.diameter_share), nan=1.0), axis=0)
    errors = held.slope_rms.mean(axis=0)
    errors = np.where(errors * diameters <= errors[0] * diameters[0], errors, np.inf)
    return int(np.flatnonzero(errors <= _BEST_WITHIN * errors.min())[0])


def measure_uncalibrated_errors(known: PressSet, read: SlopeReader) -> Doubles:
    """Diameter errors, as shares, of what is read of the presses without a calibration; NaN = no ball is seen."""
    return np.array(
        [
            measure_diameter_error(gather_contact_slopes(p, *read(p.index)), sample_contact(p, known.ball))
            for p in known.presses
        ]
    )


def clip_errors(errors: Doubles) -> Doubles:
    """Diameter errors, none worse than that of a ball that is not seen."""
    return np.asarray(np.minimum(np.nan_to_num(errors, nan=_UNSEEN), _UNSEEN), np.float64)


def is_significantly_better(share: float, without: Doubles, held: Doubles) -> bool:
    """Whether a correction of which the diameter error `share` is expected is surely better than errors without any.

    `held` are its own errors of the same presses, none where none could be held out. Press for press they have to be
    smaller by more than luck (Wilcoxon's signed ranks), or in the middle by so much that luck cannot have it: both
    middles are of few errors. Four presses cannot be sure by their ranks.
    """
    n, middle = len(without), float(np.median(np.abs(without)))
    if share >= middle:
        return False
    by_far = share * math.exp(_SURE * math.sqrt(2.0) * _MEDIAN_UNSURE / math.sqrt(n)) < middle
    if by_far or len(held) != n:
        return by_far
    gained = np.abs(without) - np.minimum(np.nan_to_num(np.abs(held), nan=_UNSEEN), _UNSEEN)
    ranks = np.empty(n)
    ranks[np.argsort(np.abs(gained), kind="stable")] = np.arange(1, n + 1)
    deviation = math.sqrt(n * (n + 1) * (2 * n + 1) / 6.0)
    return float((np.sign(gained) * ranks).sum()) > _SURE * deviation


def compute_slope_error(model: SlopeModel, samples: SlopeSamples) -> float:
    """Rms error of the slopes, mm/mm; infinite without pixels."""
    if len(samples.u) == 0:
        return float("inf")
    return float(np.sqrt(np.mean((slope_model.predict(model, samples) - samples.slopes) ** 2)))


def compute_diameter_error(model: SlopeModel, samples: SlopeSamples) -> float:
    """The diameter of the sphere nearest to the slopes of a contact, less the ball's, over the ball's; NaN = none."""
    return measure_diameter_error(slope_model.predict(model, samples), samples)


def measure_diameter_error(slopes: Floats, samples: SlopeSamples) -> float:
    """`diameter_error` of slopes (n, 2) that are read at the samples."""
    return compute_sphere_error(slopes, samples.slopes) if len(slopes) >= _FEWEST_PX else float("nan")


def compute_sphere_error(slopes: Floats | Doubles, true: Floats | Doubles) -> float:
    """How much larger than the true sphere's the radius of the sphere nearest to slopes (n, 2) is, as a share."""
    normal, wanted = (g / np.sqrt(1.0 + (g**2).sum(axis=1, keepdims=True)) for g in (slopes, true))
    normal, wanted = normal - normal.mean(axis=0), wanted - wanted.mean(axis=0)
    curvature = float((normal * wanted).sum() / (wanted**2).sum())  # over the true one
    return 1.0 / max(curvature, 0.05) - 1.0
