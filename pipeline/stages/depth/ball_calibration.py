"""Calibration from presses of a ball: the description's table, its depth scaled, or a table of the
presses, whichever measures balls best.

The depth stage without calibration knows more than the built-in table (it estimates the
illumination), so its diameters of the presses are what the other two have to beat: a table
significantly, press by press, on presses that it was not fitted to. Both are judged by the
diameters that the stage then measures, since slopes alone do not show wrong contacts; stated is the
larger of that error and the one of held-out presses.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pipeline.calibration.balls import (
    PressSet,
    clip_sizes,
    compute_coverage_map,
    cross_validate,
    find_presses,
    fit_table,
    list_fits,
    summarise_errors,
)
from pipeline.calibration.calibration_table import (
    Calibration,
    ExpectedError,
    make_built_in,
    make_thumbnail,
)
from pipeline.calibration.contact_circles import find_largest_part, fit_sphere
from pipeline.core.arrays import Doubles, Floats, Image, Mask, freeze
from pipeline.core.frozen import frozen
from pipeline.core.progress import SILENT, Progress
from pipeline.core.values.frames import TactileFrame
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth.photometric import DepthParams, estimate_gel_depth

_MEASURED_MAX = 8  # presses that a calibration measures to be judged
_CHANCE = 0.025  # with which a table that gains nothing would be taken
_COVERAGE_MIN = 0.5  # of the image


def calibrate_sensor(
    images: Sequence[Image],
    reference: Image,
    sensor: SensorSpec,
    diameter_mm: float,
    *,
    pixel_mm: float | None = None,
    progress: Progress = SILENT,
) -> Calibration:
    """The calibration of `sensor` from images (rows, cols, 3) of presses of one ball.

    `pixel_mm` None: the sensor's. Raises ShapeError for images of another size, CalibrationError if
    no image shows a ball or its size is impossible.
    """
    plain = make_built_in(sensor)
    plain = plain if pixel_mm is None else replace(plain, pixel_mm=pixel_mm)
    known = find_presses(
        images,
        reference,
        sensor,
        diameter_mm,
        pixel_mm=plain.pixel_mm,
        progress=progress,
    )

    def measure(index: int, calibration: Calibration) -> tuple[float, bool]:
        """Diameter over the true one of a press, NaN = no ball, and whether its light errs by
        places.
        """
        frame = TactileFrame(
            sensor=sensor.name, image=images[index], reference=reference, index=index
        )
        depth, light = estimate_gel_depth(frame, sensor, calibration, DepthParams())
        contact = find_largest_part(depth.contact)
        found_mm, _ = fit_sphere(depth.indentation_mm, contact, calibration.pixel_mm)
        return found_mm / diameter_mm, light is not None and light.is_bound_to_place

    progress.step(0.6, "measuring the presses without calibration")
    measured = [measure(press.index, plain) for press in known.presses]
    ratio = np.array([found for found, _ in measured])
    by_place = np.array([found if at_place else math.nan for found, at_place in measured])
    sized = ratio[np.isfinite(ratio)]
    why = (
        "did not improve it significantly"
        if has_coverage(compute_coverage_map(known))
        else "cover too little of the image; press in more places"
    )
    without = replace(
        plain,
        uses_built_in=True,
        diameter_ratio=float(np.median(sized)) if sized.size else None,
        reference_thumbnail=make_thumbnail(reference),
        expected_error=summarise_errors(ratio - 1.0),
        origin=f"the built-in table: presses {why}",
        presses=list_fits(len(images), known, plain.model),
    )
    held = cross_validate(
        known, lambda share: progress.step(0.7 + 0.2 * share, "validating on held-out presses")
    )
    scaled = add_depth_scale(without, known, ratio, by_place)
    table = replace_table(without, known, ratio - 1.0, held)
    best = without
    for found in filter(None, (scaled, table)):
        own = known.presses[:: max(1, len(ratio) // _MEASURED_MAX)]
        errors = np.array([measure(press.index, found)[0] for press in own]) - 1.0
        seen = summarise_errors(errors)
        if _get_share(seen) < _get_share(best.expected_error):
            stated = max(found.expected_error, seen, key=_get_share)
            best = replace(found, expected_error=stated)
    progress.step(1.0, "calibration is ready")
    given = f"{len(ratio)} of {len(images)} presses of a ball of {diameter_mm:g} mm"
    return replace(best, origin=f"{best.origin} ({given})")


def replace_table(
    without: Calibration, known: PressSet, errors: Doubles, held: Doubles
) -> Calibration | None:
    """The calibration with a table of the presses.

    None where they cover too little, or where its errors when held out are not significantly
    smaller than those without calibration, both (n,) and relative.
    """
    coverage = compute_coverage_map(known)
    if not has_coverage(coverage) or not is_significantly_better(held, errors):
        return None
    model = fit_table(known)
    where = (
        ""
        if coverage.all()
        else (
            f" in {coverage.mean():.0%} of the image; elsewhere no calibration is used, so press "
            "there too"
        )
    )
    return replace(
        without,
        model=model,
        uses_built_in=False,
        coverage_map=None if coverage.all() else coverage,
        presses=list_fits(len(without.presses), known, model),
        expected_error=summarise_errors(held),
        origin=f"the built-in table, corrected by presses{where}",
    )


def has_coverage(coverage: Mask) -> bool:
    """Whether presses cover enough of the image; elsewhere a table's error is unknown."""
    return bool(coverage.mean() >= _COVERAGE_MIN)


def is_significantly_better(held: Doubles, errors: Doubles) -> bool:
    """Whether errors `held` (n,) are smaller than `errors`, press by press (Wilcoxon's signed
    ranks, which five presses are too few for).
    """
    from scipy.stats import wilcoxon

    gain = clip_sizes(errors) - clip_sizes(held)
    if not gain.any():
        return False
    _, chance = np.asarray(wilcoxon(gain, alternative="greater"), np.float64)
    return float(chance) < _CHANCE


def add_depth_scale(
    without: Calibration, known: PressSet, ratio: Doubles, by_place: Doubles
) -> Calibration | None:
    """The calibration with a depth scale, from ratios (n,) of measured to true diameter.

    NaN = no ball detected. `by_place`: the same where the light errs by places, else NaN. Only such
    touches are scaled: None where most presses are none.
    """
    bound = np.isfinite(by_place)
    if 2 * np.count_nonzero(bound) <= len(ratio):
        return None
    x, y = (np.array([getattr(p.circle, n) for p in known.presses]) for n in ("x_px", "y_px"))
    scale = fit_depth_scale(x, y, by_place, known.shape)
    if scale is None:
        return None
    errors = np.concatenate([scale.errors, ratio[~bound] - 1.0])  # the others are not scaled
    return replace(
        without,
        depth_scale_map=scale.factors,
        expected_error=summarise_errors(errors),
        origin="the built-in table, depth scaled by presses",
    )


def _get_share(error: ExpectedError | None) -> float:
    assert error is not None
    return error.diameter_share


# Standard deviations of the logarithm, and a correlation length in half-widths of the image: best
# of a few on real presses of a GelSlim 3 and a DIGIT (`docs/experiments.md`).
_SHARED = 0.12
_LOCAL = 0.1
_NOISE = 0.05
_REACH = 0.4
_LARGEST = 0.5  # logarithm, of a press: more is a press misread
_GRID = 16  # places along each side of the image


@frozen
class DepthScale:
    """Factors of depth, and what is left of the presses when each is predicted by the others."""

    factors: Floats  # (_GRID, _GRID) over the whole image, down and across
    errors: Doubles  # (n,) relative diameter errors of held-out presses


def fit_depth_scale(
    x: Doubles, y: Doubles, ratio: Doubles, shape: tuple[int, int]
) -> DepthScale | None:
    """The scale from centres in px and ratios (n,) of measured to true diameter.

    None without a measured press.

    Where depth without calibration makes a ball too large, light differs there from the described
    one, and the depth of other touches there is too small by the same factor. The logarithm of that
    factor is one Gaussian process over the image: an error that all places share, and a smooth one.
    Its mean is shrunk by how few presses there are and how far they are: to the shared error away
    from them, and to none where they are few.

    `shape`: rows and columns of the image.
    """
    rows, cols = shape
    measured = np.isfinite(ratio) & (ratio > 0)
    if not measured.any():
        return None
    half = 0.5 * max(shape)
    places = np.stack([x, y], axis=1)[measured] / half
    logs = np.clip(np.log(ratio[measured]), -_LARGEST, _LARGEST)
    across, down = np.meshgrid(*((np.arange(_GRID) + 0.5) / _GRID * n / half for n in (cols, rows)))
    grid = np.stack([across.ravel(), down.ravel()], axis=1)
    factors = np.exp(_predict(places, logs, grid)).reshape(_GRID, _GRID)
    errors = np.expm1(np.log(ratio[measured]) - _predict_each_by_others(places, logs))
    return DepthScale(factors=freeze(factors.astype(np.float32)), errors=errors)


def _predict(places: Doubles, logs: Doubles, at: Doubles) -> Doubles:
    """Mean of the process (k,) at places (k, 2), given its values `logs` (n,) at `places` (n,
    2).
    """
    known = _compute_covariance(places, places) + _NOISE**2 * np.eye(len(places))
    return np.asarray(_compute_covariance(at, places) @ np.linalg.solve(known, logs), np.float64)


def _predict_each_by_others(places: Doubles, logs: Doubles) -> Doubles:
    """Prediction (n,) of each value by the others; 0 for a single one."""
    every = np.arange(len(logs))
    return np.array([_predict(places[every != i], logs[every != i], places[[i]])[0] for i in every])


def _compute_covariance(first: Doubles, second: Doubles) -> Doubles:
    apart = ((first[:, None] - second) ** 2).sum(axis=-1)
    return np.asarray(_SHARED**2 + _LOCAL**2 * np.exp(-0.5 * apart / _REACH**2), np.float64)
