"""Calibration from presses of a ball, on the depth stage without calibration.

The uncalibrated stage knows more than the built-in table (it estimates the illumination), so its
slopes of every press are what a calibration table has to beat; its depth of the presses as well, as
slopes alone do not show wrong contacts. Where it does not, as with few presses, the presses scale
the depth of the uncalibrated stage by places (`fit_depth_scale`). Table and scale are compared, and
kept, by the depth that the stage then measures.
"""

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pipeline.calibration.balls import calibrate_balls
from pipeline.calibration.calibration_table import (
    BallFit,
    Calibration,
    ExpectedError,
    make_built_in,
)
from pipeline.calibration.contact_circles import find_largest_part, fit_sphere
from pipeline.calibration.corrections import summarise_errors
from pipeline.core.arrays import Doubles, Floats, Image, freeze
from pipeline.core.progress import SILENT, Progress
from pipeline.core.values.frames import TactileFrame
from pipeline.core.values.results import DepthMap
from pipeline.physics.optics import compute_slopes
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth.illumination.light import Illumination
from pipeline.stages.depth.photometric import DepthParams, estimate_depth, estimate_gel_depth

_PRESSES_MAX = 8  # used to fit the contact limit, and to measure a table
_SHARES = (0.45, 0.6, 0.75)
_WIDTH_RATIO_MAX = (
    # of contact width to circle: balls on simulated gels 0.96, on a real Mini 1.03, on a GelSlim 3
    # 1.16
    1.08
)


def calibrate_sensor(
    images: Sequence[Image],
    reference: Image,
    sensor: SensorSpec,
    diameter_mm: float,
    *,
    pixel_mm: float | None = None,
    progress: Progress = SILENT,
    seed: int = 0,
) -> Calibration:
    """The calibration of `calibrate_balls`.

    Depth by the description, scaled, where its table is not better.
    """
    plain = make_built_in(sensor)
    if pixel_mm is not None:
        plain = replace(plain, pixel_mm=pixel_mm)

    @functools.cache
    def read(index: int) -> tuple[DepthMap, Illumination | None]:
        frame = TactileFrame(
            sensor=sensor.name, image=images[index], reference=reference, index=index
        )
        return estimate_gel_depth(frame, sensor, plain, DepthParams())

    def read_slopes(index: int) -> tuple[Floats, Floats]:
        return compute_slopes(read(index)[0].indentation_mm, plain.pixel_mm)

    found = calibrate_balls(
        images,
        reference,
        sensor,
        diameter_mm,
        pixel_mm=pixel_mm,
        progress=progress,
        seed=seed,
        read_slopes=read_slopes,
    )
    diameters_mm = np.array(
        [_measure_diameter(*read(fit.index), found.pixel_mm) for fit in found.presses]
    )
    found = add_diameter_ratio(found, diameters_mm[:, 0] / diameter_mm)
    ratio, by_place = diameters_mm.T / diameter_mm
    by_description = found if found.uses_built_in else keep_description(found, plain, ratio)
    scaled = add_depth_scale(by_description, ratio, by_place)
    if scaled is not by_description:
        error = measure_table_error(scaled, images, reference, sensor, diameter_mm)
        unscaled = np.nan_to_num(
            [ratio[fit.index] - 1.0 for fit in _select_presses(found)], nan=1.0
        )
        if error.diameter_share < summarise_errors(unscaled).diameter_share:
            predicted = scaled.expected_error
            is_known = predicted is not None and predicted.diameter_share > error.diameter_share
            by_description = scaled if is_known else replace(scaled, expected_error=error)
    if found.uses_built_in:
        return by_description
    by_table = fit_contact_limit(found, images, reference, sensor)
    error = measure_table_error(by_table, images, reference, sensor, diameter_mm)
    other = by_description.expected_error
    return (
        by_table if other is None or error.diameter_share < other.diameter_share else by_description
    )


def keep_description(found: Calibration, plain: Calibration, ratio: Doubles) -> Calibration:
    """The calibration with the description's table, by ratios (n,) of measured to true diameter
    with that.
    """
    used = ratio[[fit.used for fit in found.presses]]
    return replace(
        found,
        model=plain.model,
        uses_built_in=True,
        coverage_map=None,
        expected_error=summarise_errors(np.nan_to_num(used - 1.0, nan=1.0)),
        origin=f"the built-in table: {len(used)} presses are measured no better with a table of "
        "their own",
    )


def measure_table_error(
    table: Calibration,
    images: Sequence[Image],
    reference: Image,
    sensor: SensorSpec,
    diameter_mm: float,
) -> ExpectedError:
    """Errors of the diameters of presses that a calibration, by a table or a scale, was fitted
    to.
    """
    errors: list[float] = []
    for fit in _select_presses(table):
        frame = TactileFrame(
            sensor=sensor.name, image=images[fit.index], reference=reference, index=fit.index
        )
        depth = estimate_depth(frame, sensor, table, DepthParams())
        diameter, _ = fit_sphere(
            depth.indentation_mm, find_largest_part(depth.contact), table.pixel_mm
        )
        errors.append(diameter / diameter_mm - 1.0)
    return summarise_errors(np.nan_to_num(errors, nan=1.0))


def _select_presses(found: Calibration) -> list[BallFit]:
    """Some of the presses that a calibration uses."""
    fits = [fit for fit in found.presses if fit.used]
    return fits[:: max(1, len(fits) // _PRESSES_MAX)]


def _measure_diameter(
    depth: DepthMap, light: Illumination | None, pixel_mm: float
) -> tuple[float, float]:
    """Diameter in mm of a press, and again if its light errs by places, as a depth scale assumes.

    NaN = not known.
    """
    diameter_mm, _ = fit_sphere(depth.indentation_mm, find_largest_part(depth.contact), pixel_mm)
    return diameter_mm, diameter_mm if light is not None and light.is_bound_to_place else math.nan


def add_diameter_ratio(found: Calibration, ratio: Doubles) -> Calibration:
    """The calibration with the median of ratios (n,) of measured to true diameter, of which some
    may be NaN.
    """
    known = ratio[[fit.used for fit in found.presses]]
    known = known[np.isfinite(known)]
    return replace(found, diameter_ratio=float(np.median(known)) if known.size else None)


def add_depth_scale(found: Calibration, ratio: Doubles, by_place: Doubles) -> Calibration:
    """The calibration with a depth scale, from ratios (n,) of measured to true diameter.

    NaN = no ball detected.

    `by_place`: the same where the light errs by places, else NaN. Only such touches are scaled:
    nothing changes where most presses are none.
    """
    used = [fit.used for fit in found.presses]
    if 2 * np.count_nonzero(np.isfinite(by_place[used])) <= sum(used):
        return found
    x, y = (
        np.array([getattr(fit, name) for fit in found.presses])[used] for name in ("x_px", "y_px")
    )
    scale = fit_depth_scale(x, y, by_place[used], (found.rows, found.cols))
    if scale is None:
        return found
    others = ratio[used][~np.isfinite(by_place[used])] - 1.0  # are not scaled
    return replace(
        found,
        depth_scale_map=scale.factors,
        expected_error=summarise_errors(
            np.concatenate([scale.errors, np.nan_to_num(others, nan=1.0)])
        ),
        origin=f"the built-in table, depth scaled by {len(scale.errors)} presses of a ball",
    )


def fit_contact_limit(
    found: Calibration, images: Sequence[Image], reference: Image, sensor: SensorSpec
) -> Calibration:
    """The calibration with the share of the median pressure at which contacts end on this gel.

    A skin or coating that bridges the gel next to a ball looks like pressure there: where contacts
    of the presses are wider than their circles, the smallest share that prevents it is taken.
    """
    fits = _select_presses(found)

    def measure_width_ratio(look_up: Calibration) -> float:
        widths: list[float] = []
        for fit in fits:
            frame = TactileFrame(
                sensor=sensor.name, image=images[fit.index], reference=reference, index=fit.index
            )
            area = np.count_nonzero(estimate_depth(frame, sensor, look_up, DepthParams()).contact)
            widths.append(math.sqrt(area / math.pi) / fit.radius_px)
        return float(np.median(widths))

    for share in (None, *_SHARES):
        look_up = replace(found, median_pressure_share=share)
        if measure_width_ratio(look_up) <= (_WIDTH_RATIO_MAX if share is None else 1.0):
            return look_up
    return replace(found, median_pressure_share=_SHARES[-1])


# Standard deviations of the logarithm, and a correlation length in half-widths of the image: best
# of a few on real presses of a GelSlim 3 and a DIGIT (`docs/experiments.md`).
_SHARED = 0.12
_LOCAL = 0.1
_NOISE = 0.05
_REACH = 0.4
_LARGEST = 0.5  # logarithm, of a press: more is a press misread
_GRID = 16  # places along each side of the image


@dataclass(frozen=True, slots=True, kw_only=True)
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
