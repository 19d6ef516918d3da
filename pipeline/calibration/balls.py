"""Calibration of a sensor from presses of one ball: circles and calibration table are estimated
together.

Inside its contact the gel has the ball's shape: at p the slope is -(p - c) / sqrt(R^2 - |p - c|^2)
for a centre c, whatever the load, so only centres must be known well. They are refined in
alternation with the table: each pixel's predicted slope g gives a centre c = p + R g / sqrt(1 +
g^2), and the median over the contact is taken. Outside the trusted part of the contact, which lens
blur does not affect, the slope is not the ball's, but it is radially symmetric and, in units of the
contact's radius, equal in all presses: the median profile of all presses keeps a centre from
drifting together with the table around it. The presses correct the sensor's description
(`corrections`); a correction must hold on validation presses and be significantly better than depth
without calibration.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pipeline.calibration import near_led_prior
from pipeline.calibration.ball_presses import (
    BallPress,
    BallSlopeProfile,
    estimate_common_profile,
    refine_circle,
    sample_contact,
)
from pipeline.calibration.calibration_table import (
    BallFit,
    Calibration,
    compute_relative_change,
    make_built_in,
    make_thumbnail,
)
from pipeline.calibration.contact_circles import Circle, detect_contact_circle
from pipeline.calibration.corrections import (
    PressSet,
    SlopeReader,
    choose_candidate,
    clip_errors,
    compute_coverage_map,
    compute_slope_error,
    cross_validate,
    estimate_expected_error,
    fit_candidates,
    fit_quick_table,
    has_enough_for_polynomials,
    has_low_coverage,
    is_significantly_better,
    measure_uncalibrated_errors,
    simulate_errors,
    summarise_errors,
)
from pipeline.calibration.slope_model import SlopeModel
from pipeline.core.arrays import Image, Mask
from pipeline.core.errors import CalibrationError, ShapeError
from pipeline.core.progress import SILENT, Progress
from pipeline.sensors.spec import SensorSpec

_ITERATIONS = 6
_OUTLIER_FACTOR = 3.0  # times the median residual: a press that is not one ball on a clean gel


def calibrate_balls(
    images: Sequence[Image],
    reference: Image,
    sensor: SensorSpec,
    diameter_mm: float,
    *,
    pixel_mm: float | None = None,
    progress: Progress = SILENT,
    seed: int = 0,
    read_slopes: SlopeReader | None = None,
) -> Calibration:
    """The calibration of `sensor` from images (rows, cols, 3) of presses of one ball.

    `pixel_mm` None: the sensor's. `read_slopes`: slopes of an image without calibration, the
    baseline to beat; None: the built-in table is the baseline. Raises ShapeError for images of
    another size, CalibrationError if no image shows a ball or its size is impossible.
    """
    scale = sensor.pixel_mm if pixel_mm is None else pixel_mm
    ball_px = 0.5 * diameter_mm / scale if scale > 0 else math.nan
    if not (math.isfinite(ball_px) and ball_px > 3.0):
        raise CalibrationError(
            f"a ball of {diameter_mm!r} mm cannot be seen at {scale!r} mm/px; check both"
        )
    presses = _detect_presses(images, reference, sensor, scale, ball_px, progress)
    initial = PressSet(
        presses=tuple(presses),
        ball=BallSlopeProfile(radius_px=ball_px, sphere_slope_share=None),
        pixel_mm=scale,
        prior=near_led_prior.compute_prior(sensor, scale, reference.shape[:2]),
        built_in=make_built_in(sensor).model,
        seed=seed,
    )
    known = _reject_outliers(initial, progress)
    held = cross_validate(
        known, lambda share: progress.step(0.6 + 0.3 * share, "validating on held-out presses")
    )
    models, fields = fit_candidates(
        known, polynomials=has_enough_for_polynomials(len(known.presses))
    )
    best = choose_candidate(held)
    virtual = simulate_errors(models[best], fields, known)
    has_low = False
    coverage = None
    error = estimate_expected_error(virtual, held, best)
    baseline = None if read_slopes is None else measure_uncalibrated_errors(known, read_slopes)
    if baseline is not None:
        without = clip_errors(baseline)
        validated = np.zeros(0) if held is None else held.diameter_share[:, best]
        coverage = compute_coverage_map(virtual, known)
        has_low = has_low_coverage(known)
        if (
            has_low
            or not best
            or not is_significantly_better(error.diameter_share, without, validated)
        ):
            best = 0
            error = summarise_errors(without)
            coverage = None
    model = models[best]
    progress.step(1.0, "calibration is ready")
    errors = [compute_slope_error(model, sample_contact(p, known.ball)) for p in known.presses]
    origin = _describe_origin(
        len(known.presses), len(images), diameter_mm, best, has_low_coverage=has_low
    )
    return Calibration(
        sensor=sensor.name,
        rows=reference.shape[0],
        cols=reference.shape[1],
        pixel_mm=scale,
        model=model,
        residual=float(np.sqrt(np.mean(np.square(errors)))),
        origin=origin + _describe_coverage(coverage),
        uses_built_in=best == 0,
        coverage_map=None if coverage is None or coverage.all() else coverage,
        reference_thumbnail=make_thumbnail(reference),
        presses=_list_fits(len(images), known, model),
        expected_error=error,
    )


def _describe_origin(
    used: int, given: int, diameter_mm: float, best: int, *, has_low_coverage: bool
) -> str:
    presses = f"{used} of {given} presses of a ball of {diameter_mm:g} mm"
    if best == 0 and has_low_coverage:
        return f"the built-in table: {presses} cover too little of the image; press in more places"
    if best == 0:
        return f"the built-in table: {presses} did not improve it significantly"
    return f"the built-in table, corrected by {presses}"


def _describe_coverage(coverage: Mask | None) -> str:
    if coverage is None or coverage.all():
        return ""
    return (
        f" in {coverage.mean():.0%} of the image; elsewhere no calibration is used, so press "
        "there too"
    )


def _detect_presses(
    images: Sequence[Image],
    reference: Image,
    sensor: SensorSpec,
    scale: float,
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
        change = compute_relative_change(image, reference, scale, markers=sensor.markers)
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


def _reject_outliers(known: PressSet, progress: Progress) -> PressSet:
    """The presses with refined circles, without outliers: presses that are not one ball on a
    clean gel.
    """
    start = known
    known, model = _alternate(start, progress)
    errors = np.array(
        [compute_slope_error(model, sample_contact(p, known.ball)) for p in known.presses]
    )
    bad = {int(i) for i in np.flatnonzero(errors > _OUTLIER_FACTOR * float(np.median(errors)))}
    return known if not bad else _alternate(start.drop_presses(bad), progress)[0]


def _alternate(known: PressSet, progress: Progress) -> tuple[PressSet, SlopeModel]:
    model = fit_quick_table(known)
    for turn in range(_ITERATIONS):
        presses = tuple(
            replace(p, circle=refine_circle(model, p, known.ball)) for p in known.presses
        )
        ball = estimate_common_profile(model, presses, known.ball.radius_px)
        known = replace(known, presses=presses, ball=ball)
        model = fit_quick_table(known)
        progress.step(
            0.2 + 0.4 * (turn + 1) / _ITERATIONS,
            f"refining circles, iteration {turn + 1} of {_ITERATIONS}",
        )
    return known, model


def _list_fits(n: int, known: PressSet, model: SlopeModel) -> tuple[BallFit, ...]:
    used = {p.index: p for p in known.presses}
    fits: list[BallFit] = []
    for index in range(n):
        p = used.get(index)
        c = p.circle if p is not None else Circle(x_px=math.nan, y_px=math.nan, radius_px=math.nan)
        residual = (
            math.nan if p is None else compute_slope_error(model, sample_contact(p, known.ball))
        )
        fits.append(
            BallFit(
                index=index,
                x_px=c.x_px,
                y_px=c.y_px,
                radius_px=c.radius_px,
                residual=residual,
                used=p is not None,
            )
        )
    return tuple(fits)
