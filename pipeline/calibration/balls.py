"""Presses of one ball: their circles, and the calibration table that they determine.

Inside its contact the gel has the ball's shape: at p the slope is -(p - c) / sqrt(R^2 - |p - c|^2)
for a centre c, whatever the load, so only centres must be known well. They are refined in
alternation with the table. Outside the trusted part of the contact, which lens blur does not
affect, the slope is not the ball's, but it is radially symmetric and, in units of the contact's
radius, equal in all presses: the median profile of all presses keeps a centre from drifting
together with the table around it. The table is the regression of slopes on the colours of the
shading fields (`shading_field`) that the presses leave possible.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from pipeline.calibration import near_led_prior, shading_field, slope_model
from pipeline.calibration.ball_presses import (
    BallPress,
    BallSlopeProfile,
    estimate_common_profile,
    refine_circle,
    sample_contact,
    sample_surface,
)
from pipeline.calibration.calibration_table import (
    P90_OVER_STD,
    USUAL_STD,
    BallFit,
    ExpectedError,
    compute_relative_change,
)
from pipeline.calibration.contact_circles import Circle, detect_contact_circle
from pipeline.calibration.shading_field import ShadingFieldPrior
from pipeline.calibration.slope_model import SlopeModel, SlopeSamples
from pipeline.core.arrays import Doubles, Floats, Image, Mask, freeze
from pipeline.core.errors import CalibrationError, ShapeError
from pipeline.core.frozen import frozen
from pipeline.core.progress import Progress
from pipeline.sensors.spec import SensorSpec

_ITERATIONS = 6
_OUTLIER_FACTOR = 3.0  # times the median residual: a press that is not one ball on a clean gel
# shading fields and pixels that a table is fitted to
_DRAWS = 40
_PIXELS = 8000
_QUICK_PIXELS = 4000  # while the circles are refined
_RIDGE = 3e-4  # of the polynomial
_POSITION_DEGREE = 2  # of the polynomial: less than the table's, which the field determines
_POLYNOMIAL_PRESSES_MIN = 8  # presses that a table is fitted to
_FOLDS = 6
_SPHERE_PIXELS_MIN = 12  # pixels that a sphere is fitted to
_COVERAGE_GRID = (12, 12)  # places down and across
# half-widths of the image from a press: within this, light correlates by three quarters
_NEAR_SHARE = 0.5
_PRIOR_PRESSES = 8.0  # presses that the usual error counts as
_MEDIAN_MIN = 0.005  # smaller medians of a few errors are chance
_STD_OVER_MEAN = 1.253  # standard deviation of normal errors over the mean of their sizes
# of the sizes of normal errors; the mean of a few is more certain by a third
_MEDIAN_OVER_MEAN = 0.845


@frozen
class PressSet:
    """Presses and the prior that a table is fitted to."""

    presses: tuple[BallPress, ...]
    ball: BallSlopeProfile
    pixel_mm: float
    prior: ShadingFieldPrior

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


def find_presses(
    images: Sequence[Image],
    reference: Image,
    sensor: SensorSpec,
    diameter_mm: float,
    *,
    pixel_mm: float,
    progress: Progress,
) -> PressSet:
    """The presses of one ball among images (rows, cols, 3), without outliers.

    Raises ShapeError for images of another size, CalibrationError if no image shows a ball or its
    size is impossible.
    """
    ball_px = 0.5 * diameter_mm / pixel_mm if pixel_mm > 0 else math.nan
    if not (math.isfinite(ball_px) and ball_px > 3.0):
        raise CalibrationError(
            f"a ball of {diameter_mm!r} mm cannot be seen at {pixel_mm!r} mm/px; check both"
        )
    presses = _detect_presses(images, reference, sensor, pixel_mm, ball_px, progress)
    start = PressSet(
        presses=tuple(presses),
        ball=BallSlopeProfile(radius_px=ball_px),
        pixel_mm=pixel_mm,
        prior=near_led_prior.compute_prior(sensor, pixel_mm, reference.shape[:2]),
    )
    known, model = _refine_circles(start, progress)
    errors = np.array([compute_slope_error(model, p, known.ball) for p in known.presses])
    bad = {int(i) for i in np.flatnonzero(errors > _OUTLIER_FACTOR * float(np.median(errors)))}
    return known if not bad else _refine_circles(start.drop_presses(bad), progress)[0]


def _detect_presses(
    images: Sequence[Image],
    reference: Image,
    sensor: SensorSpec,
    pixel_mm: float,
    ball_px: float,
    progress: Progress,
) -> list[BallPress]:
    if not images:
        raise CalibrationError("no images of presses; give a folder with at least one")
    presses: list[BallPress] = []
    for index, image in enumerate(images):
        if image.shape != reference.shape or image.ndim != 3:
            raise ShapeError(
                f"press {index} has shape {image.shape}, the reference {reference.shape}; use one "
                "camera mode"
            )
        change = compute_relative_change(image, reference, pixel_mm, markers=sensor.markers)
        circle = detect_contact_circle(change)
        if circle is not None and circle.radius_px >= 3.0:
            circle = replace(circle, radius_px=min(circle.radius_px, 0.9 * ball_px))
            presses.append(BallPress(index=index, change=change, circle=circle))
        progress.step(
            0.2 * (index + 1) / len(images),
            f"detecting the ball in press {index + 1} of {len(images)}",
        )
    if not presses:
        raise CalibrationError(
            "no ball found in any press; check that the reference is the untouched sensor"
        )
    return presses


def _refine_circles(known: PressSet, progress: Progress) -> tuple[PressSet, SlopeModel]:
    model = fit_table(known, quick=True)
    for turn in range(_ITERATIONS):
        presses = tuple(
            replace(p, circle=refine_circle(model, p, known.ball)) for p in known.presses
        )
        ball = estimate_common_profile(model, presses, known.ball.radius_px)
        known = replace(known, presses=presses, ball=ball)
        model = fit_table(known, quick=True)
        progress.step(
            0.2 + 0.4 * (turn + 1) / _ITERATIONS,
            f"refining circles, iteration {turn + 1} of {_ITERATIONS}",
        )
    return known, model


def fit_table(known: PressSet, *, quick: bool = False) -> SlopeModel:
    """The table of the shading fields that the presses leave possible; quick: of their mean.

    Many presses tell more than a field can: a polynomial of the slopes that it leaves is added.
    """
    rng = np.random.default_rng(0)
    field = shading_field.update_field(
        known.prior, [sample_surface(p, known.ball, known.pixel_mm, rng) for p in known.presses]
    )
    if quick:
        return shading_field.fit_slope_model(field.mean[None], known.shape, _QUICK_PIXELS, rng)
    fields = shading_field.sample_fields(field, _DRAWS, rng)
    base = shading_field.fit_slope_model(fields, known.shape, _PIXELS, rng)
    if len(known.presses) < _POLYNOMIAL_PRESSES_MIN:
        return base
    parts = [sample_contact(p, known.ball, rng) for p in known.presses]
    change, u, v, slopes = (
        np.concatenate([getattr(part, name) for part in parts])
        for name in ("change", "u", "v", "slopes")
    )
    samples = SlopeSamples(change=change, u=u, v=v, slopes=slopes)
    more = slope_model.fit(
        replace(samples, slopes=slopes - slope_model.predict(base, samples)),
        colour_degree=base.colour_degree,
        position_degree=_POSITION_DEGREE,
        ridge=_RIDGE,
    )
    wider = base.position_degree - _POSITION_DEGREE
    table = np.pad(more.coefficients, ((0, wider), (0, wider), (0, 0), (0, 0)))
    return replace(base, coefficients=freeze(base.coefficients + table))


def cross_validate(known: PressSet, step: Callable[[float], None]) -> Doubles:
    """Relative diameter errors (n,) of every press with a table fitted to others.

    NaN = no ball detected, or no other press.
    """
    n = len(known.presses)
    errors = np.full(n, np.nan)
    folds = np.array_split(np.random.default_rng(0).permutation(n), min(n, _FOLDS))
    for done, fold in enumerate(folds if n > 1 else ()):
        model = fit_table(known.drop_presses({int(i) for i in fold}))
        for i in fold:
            samples = sample_contact(known.presses[i], known.ball)
            errors[i] = measure_diameter_error(slope_model.predict(model, samples), samples)
        step((done + 1) / len(folds))
    return errors


def compute_slope_error(model: SlopeModel, press: BallPress, ball: BallSlopeProfile) -> float:
    """Rms slope error in the contact of a press, mm/mm; infinite without pixels."""
    samples = sample_contact(press, ball)
    if len(samples.u) == 0:
        return float("inf")
    return float(np.sqrt(np.mean((slope_model.predict(model, samples) - samples.slopes) ** 2)))


def measure_diameter_error(slopes: Floats, samples: SlopeSamples) -> float:
    """Relative error of the diameter of the sphere fitted to slopes (n, 2) at samples.

    NaN with too few of them.
    """
    if len(slopes) < _SPHERE_PIXELS_MIN:
        return float("nan")
    normal, wanted = (
        g / np.sqrt(1.0 + (g**2).sum(axis=1, keepdims=True)) for g in (slopes, samples.slopes)
    )
    normal = normal - normal.mean(axis=0)
    wanted = wanted - wanted.mean(axis=0)
    curvature = float((normal * wanted).sum() / (wanted**2).sum())  # over the true one
    return 1.0 / max(curvature, 0.05) - 1.0


def compute_coverage_map(known: PressSet) -> Mask:
    """Places (down, across) that have a press near; elsewhere the shading field is a guess."""
    rows, cols = known.shape
    x, y = np.meshgrid(
        *((np.arange(k) + 0.5) / k * n for n, k in zip((cols, rows), _COVERAGE_GRID, strict=True))
    )
    away = np.min([np.hypot(x - p.circle.x_px, y - p.circle.y_px) for p in known.presses], axis=0)
    return freeze(np.asarray(away < _NEAR_SHARE * 0.5 * max(known.shape), np.bool_))


def clip_sizes(errors: Doubles) -> Doubles:
    """Sizes of diameter errors; a ball that is not detected (NaN) is wholly wrong."""
    return np.asarray(np.minimum(np.abs(np.nan_to_num(errors, nan=1.0)), 1.0), np.float64)


def summarise_errors(errors: Doubles) -> ExpectedError:
    """The expected error of balls, from relative diameter `errors` of presses that the calibration
    does not know; NaN = no ball detected.
    """
    errors = np.minimum(np.nan_to_num(errors, nan=1.0), 1.0)

    def estimate_median(sizes: Doubles) -> float:
        return max(_MEDIAN_OVER_MEAN * float(np.abs(sizes).mean()), _MEDIAN_MIN)

    def estimate_p90(sizes: Doubles) -> float:
        n = len(sizes)  # few presses seldom include the largest errors
        mean = _STD_OVER_MEAN * float(np.abs(sizes).sum())
        return P90_OVER_STD * (_PRIOR_PRESSES * USUAL_STD + mean) / (_PRIOR_PRESSES + n)

    # The indentation of a ball of known size is proportional to the measured curvature.
    depth = 1.0 / (1.0 + errors) - 1.0
    return ExpectedError(
        diameter_share=estimate_median(errors),
        diameter_p90=estimate_p90(errors),
        depth_share=estimate_median(depth),
        depth_p90=estimate_p90(depth),
        n_held_out=len(errors),
    )


def list_fits(n: int, known: PressSet, model: SlopeModel) -> tuple[BallFit, ...]:
    """The fits of `n` images, with residuals by a table."""
    used = {p.index: p for p in known.presses}
    nowhere = Circle(x_px=math.nan, y_px=math.nan, radius_px=math.nan)
    fits: list[BallFit] = []
    for index in range(n):
        press = used.get(index)
        circle = nowhere if press is None else press.circle
        fits.append(
            BallFit(
                index=index,
                x_px=circle.x_px,
                y_px=circle.y_px,
                radius_px=circle.radius_px,
                residual=math.nan
                if press is None
                else compute_slope_error(model, press, known.ball),
                used=press is not None,
            )
        )
    return tuple(fits)
