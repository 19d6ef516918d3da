"""Calibrating a sensor from presses of one ball: circles, centres and look-up found together.

Inside its contact the gel is the ball: at p from the centre c its slope is -(p - c) / sqrt(R^2 - |p - c|^2), whatever
the load, so only centres have to be known well. They are refined in turns with the look-up: each pixel's predicted
slope g says where the centre must be, c = p + R g / sqrt(1 + g^2), and the median over the contact is kept. Beyond the
trusted part of the contact, which lens blur leaves alone, the slope is not the ball's, but it is the same to all sides
and, in units of the contact's radius, in all presses: the median profile of all presses stops a centre from drifting
together with the look-up around it. The presses correct what is known of the sensor instead of replacing it
(`corrections`), and a correction that does not hold for presses that it has not seen is not made, nor one that is not
surely better than what is read without.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pipeline.base.arrays import Doubles, Image, Mask
from pipeline.base.errors import CalibrationError, ShapeError
from pipeline.base.progress import SILENT, Progress
from pipeline.calibration import near_led_prior, reference_thumbnail
from pipeline.calibration.ball_samples import sample_contact
from pipeline.calibration.ball_slopes import BallPress, BallSlopeProfile, estimate_common_profile, refine_circle
from pipeline.calibration.calibration_table import BallFit, Calibration, compute_relative_change, make_built_in
from pipeline.calibration.contact_circles import Circle, detect_contact_circle
from pipeline.calibration.corrections import (
    PressSet,
    SlopeReader,
    choose_candidate,
    clip_errors,
    compute_slope_error,
    cross_validate,
    fit_candidates,
    fit_quick_table,
    has_enough_for_polynomials,
    is_significantly_better,
    measure_uncalibrated_errors,
)  # fmt: skip
from pipeline.calibration.expected_error import (
    compute_coverage_map,
    estimate_expected_error,
    has_low_coverage,
    simulate_errors,
    summarise_errors,
)
from pipeline.calibration.slope_model import SlopeModel
from pipeline.sensors.spec import SensorSpec

_TURNS = 6
_OUTLIER = 3.0  # times the median residual: a press that is not one ball on a clean gel


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
    """The look-up of `sensor` from pictures (rows, cols, 3) of presses of one ball; `presses` tells of each.

    `pixel_mm` None takes the sensor's own. `read` tells what is read of the pictures without a calibration, which the
    presses have to better; None = no more than the built-in look-up. Raises ShapeError for pictures of another size,
    CalibrationError when no picture shows a ball or the size cannot be right.
    """
    scale = sensor.pixel_mm if pixel_mm is None else pixel_mm
    ball_px = 0.5 * diameter_mm / scale if scale > 0 else math.nan
    if not (math.isfinite(ball_px) and ball_px > 3.0):
        raise CalibrationError(f"a ball of {diameter_mm!r} mm cannot be seen at {scale!r} mm/px; check both")
    before, first = near_led_prior.compute_prior(sensor, scale, reference.shape[:2]), make_built_in(sensor).model
    presses = _found(images, reference, sensor, scale, ball_px, progress)
    known = _aligned(PressSet(presses=tuple(presses), ball=BallSlopeProfile(radius_px=ball_px, sphere_slope_share=None), pixel_mm=scale,
                             prior=before, built_in=first, seed=seed), progress)  # fmt: skip
    held = cross_validate(known, lambda share: progress.step(0.6 + 0.3 * share, "measuring presses that were held out"))
    models, fields = fit_candidates(known, polynomials=has_enough_for_polynomials(len(known.presses)))
    best = choose_candidate(held)
    virtual, narrow, places = simulate_errors(models[best], fields, known), False, None
    worth = estimate_expected_error(virtual, held, best)
    as_read = None if read_slopes is None else measure_uncalibrated_errors(known, read_slopes)
    if as_read is not None:
        without, seen = clip_errors(as_read), np.zeros(0) if held is None else held.diameter_share[:, best]
        places, narrow = compute_coverage_map(virtual, known), has_low_coverage(known)
        if narrow or not best or not is_significantly_better(worth.diameter_share, without, seen):
            best, worth, places = 0, summarise_errors(without), None
    model = models[best]
    progress.step(1.0, "look-up is ready")
    return Calibration(
        sensor=sensor.name, rows=reference.shape[0], cols=reference.shape[1], pixel_mm=scale, model=model,
        residual=float(np.sqrt(np.mean([compute_slope_error(model, sample_contact(p, known.ball)) ** 2 for p in known.presses]))),
        origin=_origin(len(known.presses), len(images), diameter_mm, best, narrow=narrow) + _where(places),
        uses_built_in=best == 0, coverage_map=None if places is None or places.all() else places,
        reference_thumbnail=reference_thumbnail.make_thumbnail(reference),
        presses=_report(len(images), known, model), expected_error=worth, diameter_ratio=_middle(as_read),
    )  # fmt: skip


def _middle(errors: Doubles | None) -> float | None:
    """The diameter read over the true one, of errors as shares of which some may be unknown."""
    seen = np.zeros(0) if errors is None else errors[np.isfinite(errors)]
    return 1.0 + float(np.median(seen)) if seen.size else None


def _origin(used: int, given: int, diameter_mm: float, best: int, *, narrow: bool) -> str:
    presses = f"{used} of {given} presses of a ball of {diameter_mm:g} mm"
    if best == 0 and narrow:
        return f"the built-in look-up: {presses} leave too much of the picture to a guess, press elsewhere too"
    if best == 0:
        return f"the built-in look-up, which {presses} did not surely better"
    return f"{presses} correct the built-in look-up"


def _where(places: Mask | None) -> str:
    if places is None or places.all():
        return ""
    return f" in {places.mean():.0%} of the picture; touches elsewhere are read without, press there too"


def _found(
    images: Sequence[Image], reference: Image, sensor: SensorSpec, scale: float, ball_px: float, progress: Progress
) -> list[BallPress]:
    if not images:
        raise CalibrationError("no pictures of presses; give a folder with at least one")
    presses: list[BallPress] = []
    for index, image in enumerate(images):
        if image.shape != reference.shape or image.ndim != 3:
            raise ShapeError(
                f"press {index} has shape {image.shape}, the reference {reference.shape}; use one camera mode"
            )
        change = compute_relative_change(image, reference, scale, markers=sensor.markers)
        circle = detect_contact_circle(change)
        if circle is not None and circle.radius_px >= 3.0:
            circle = replace(circle, radius_px=min(circle.radius_px, 0.9 * ball_px))
            presses.append(BallPress(index=index, change=change, circle=circle))
        progress.step(0.2 * (index + 1) / len(images), f"finding the ball in press {index + 1} of {len(images)}")
    if not presses:
        raise CalibrationError("no ball found in any press; check that the reference is the untouched sensor")
    return presses


def _aligned(known: PressSet, progress: Progress) -> PressSet:
    """The presses with their circles refined; those that are not one ball on a clean gel are left out."""
    start = known
    known, model = _alternated(start, progress)
    errors = np.array([compute_slope_error(model, sample_contact(p, known.ball)) for p in known.presses])
    bad = {int(i) for i in np.flatnonzero(errors > _OUTLIER * float(np.median(errors)))}
    return known if not bad else _alternated(start.drop_presses(bad), progress)[0]


def _alternated(known: PressSet, progress: Progress) -> tuple[PressSet, SlopeModel]:
    """Turns of look-up, circles and the common profile of slopes beyond the trusted contact."""
    model = fit_quick_table(known)
    for turn in range(_TURNS):
        presses = tuple(replace(p, circle=refine_circle(model, p, known.ball)) for p in known.presses)
        ball = estimate_common_profile(model, presses, known.ball.radius_px)
        known = replace(known, presses=presses, ball=ball)
        model = fit_quick_table(known)
        progress.step(0.2 + 0.4 * (turn + 1) / _TURNS, f"refining circles, turn {turn + 1} of {_TURNS}")
    return known, model


def _report(n: int, known: PressSet, model: SlopeModel) -> tuple[BallFit, ...]:
    used = {p.index: p for p in known.presses}
    fits: list[BallFit] = []
    for index in range(n):
        p = used.get(index)
        c = p.circle if p is not None else Circle(x_px=math.nan, y_px=math.nan, radius_px=math.nan)
        residual = math.nan if p is None else compute_slope_error(model, sample_contact(p, known.ball))
        fits.append(
            BallFit(index=index, x_px=c.x_px, y_px=c.y_px, radius_px=c.radius_px, residual=residual, used=p is not None)
        )
    return tuple(fits)
