"""A user's own look-up as the simulator's optics: the picture that a calibrated sensor would take of a surface.

`calibrate balls` gives slopes from colours. Here it is turned round: at nodes of place and slope, a colour change
whose slope is the one asked for, found by Newton steps. Three colours answer two slopes, so one must choose: the change
nearest to the usual one where pictures of the sensor tell it (`usual`), else nearest to none. Between the nodes the
table is linear.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Doubles, Floats, Image, freeze
from pipeline.base.errors import CalibrationError, ShapeError
from pipeline.calibration import slope_model
from pipeline.calibration.lookup import Calibration, check_for, relative_change
from pipeline.calibration.markers import inpainted, marker_mask
from pipeline.physics import optics, optics_markers
from pipeline.sensors.spec import Markers, SensorSpec

_PLACES = (7, 9)  # nodes down and across; the slope model is a low polynomial of the place
_SLOPES = 33  # nodes along each slope
_STEPS = 8
_SLOPE_DEGREE, _PLACE_DEGREE = 4, 2  # of the usual change
_TOUCHED = 0.05  # mm/mm: from here on a picture's slopes tell of a touch
_PIXELS = 3000  # taken from each picture
_RIDGE = 1e-3
_KEPT = 4  # tables of the last few calibrations

_tables: OrderedDict[tuple[object, ...], Floats] = OrderedDict()


@dataclass(frozen=True, slots=True, kw_only=True)
class Usual:
    """The usual colour change at a slope: a polynomial in slope and place without a constant term."""

    coefficients: Floats  # (place powers, slope powers, 3), powers in the order of `_exponents`


@dataclass(frozen=True, slots=True, kw_only=True)
class Printed:
    """An untouched picture taken apart: what it would be without markers, and the share of light they leave."""

    plain: Floats  # (rows, cols, 3) grey levels
    share: Floats  # (rows, cols, 3)


def rendered(
    calibration: Calibration,
    reference: Image,
    indentation_mm: NDArray[np.floating],
    sensor: SensorSpec,
    *,
    seed: int | None,
    shear_mm: NDArray[np.floating] | None = None,
    usual_change: Usual | None = None,
) -> Image:
    """The picture (rows, cols, 3) that the sensor whose untouched picture is `reference` takes of its surface.

    Blur, noise and the motion of markers are those of `sensor`; markers keep the look they have in `reference`.
    Raises CalibrationError or ShapeError when calibration, reference, surface and sensor do not belong together.
    """
    check_for(calibration, sensor.name, reference)
    if reference.shape != (*sensor.camera.shape, 3):
        raise ShapeError(f"the reference of {sensor.name} must be {(*sensor.camera.shape, 3)}, got {reference.shape}")
    optics_markers.checked(sensor, indentation_mm, shear_mm)
    still = _taken_apart(reference, sensor.markers, calibration.pixel_mm)
    gx, gy = optics.slopes(indentation_mm, calibration.pixel_mm)
    change = _blurred(colour_change(calibration, still.plain, gx, gy, usual_change), sensor)
    light = still.plain + change
    if sensor.markers is not None:
        light *= _moved(still.share, *optics_markers.marker_motion_px(sensor, indentation_mm, shear_mm))
    return freeze(optics.recorded(light, optics.optics_of(sensor).noise_grey, seed))


def colour_change(
    calibration: Calibration,
    reference: NDArray[np.generic],
    gx: NDArray[np.floating],
    gy: NDArray[np.floating],
    usual_change: Usual | None = None,
) -> Floats:
    """Grey levels (rows, cols, 3) that the slopes (rows, cols), mm/mm, add to `reference`; 0 on level ground.

    `calibration.slopes` of the changed picture gives the slopes back, up to the steepest that the calibration knows.
    """
    from pipeline.calibration.rendering_kernels import look_up

    if gx.shape != (calibration.rows, calibration.cols) or gy.shape != gx.shape:
        raise ShapeError(f"slopes must have the shape {(calibration.rows, calibration.cols)}, got {gx.shape}")
    out = np.empty((*gx.shape, 3), np.float32)
    x, y = (np.ascontiguousarray(g, dtype=np.float32) for g in (gx, gy))
    look_up(x, y, table(calibration, usual_change), np.float32(calibration.model.slope_max), out)
    return out / slope_model.gain(reference)


def usual(calibration: Calibration, images: Sequence[Image], reference: Image, sensor: SensorSpec) -> Usual:
    """What colour change goes with each slope in pictures (rows, cols, 3) of this sensor, such as those of the ball.

    Ridge regression of each picture's change on the slopes that the calibration sees in it.
    Raises CalibrationError when no picture shows a touch.
    """
    rng = np.random.default_rng(0)
    u, v = slope_model.position((calibration.rows, calibration.cols))
    features: list[Doubles] = []
    changes: list[Doubles] = []
    for image in images:
        change = relative_change(image, reference, calibration.pixel_mm, markers=sensor.markers)
        gx, gy = slope_model.evaluate(calibration.model, change, u, v, np.ones(change.shape[:2], np.bool_))
        steep = np.flatnonzero(np.hypot(gx, gy) > _TOUCHED)
        if len(steep) == 0:
            continue
        rows, cols = np.divmod(rng.choice(steep, min(len(steep), _PIXELS), replace=False), calibration.cols)
        terms = _terms(gx[rows, cols], gy[rows, cols], u[cols], v[rows])
        features.append(terms.reshape(len(terms), -1))
        changes.append(change[rows, cols].astype(np.float64))
    if not features:
        raise CalibrationError("no touch in any picture; the usual colours need presses")
    f, q = np.concatenate(features), np.concatenate(changes)
    normal = f.T @ f
    normal[np.diag_indices_from(normal)] *= 1.0 + _RIDGE
    solution = np.linalg.solve(normal + 1e-9 * np.trace(normal) * np.eye(len(normal)) / len(normal), f.T @ q)
    shape = (len(_exponents(_PLACE_DEGREE, 0)), len(_exponents(_SLOPE_DEGREE, 1)), 3)
    return Usual(coefficients=freeze(solution.reshape(shape).astype(np.float32)))


def _exponents(degree: int, lowest: int) -> list[tuple[int, int]]:
    return [(i, j) for i in range(degree + 1) for j in range(degree + 1 - i) if i + j >= lowest]


def _terms(gx: Any, gy: Any, u: Any, v: Any) -> Doubles:
    """Monomials (n, place powers, slope powers)."""
    place = np.stack([np.float64(u) ** i * np.float64(v) ** j for i, j in _exponents(_PLACE_DEGREE, 0)], axis=-1)
    slope = np.stack([np.float64(gx) ** i * np.float64(gy) ** j for i, j in _exponents(_SLOPE_DEGREE, 1)], axis=-1)
    return place[:, :, None] * slope[:, None, :]


def table(calibration: Calibration, usual_change: Usual | None = None) -> Floats:
    """Colour changes (v, u, slopes down, slopes right, 3), relative as in `slope_model`; kept for the last few."""
    model = calibration.model
    start = b"" if usual_change is None else usual_change.coefficients.tobytes()
    size = (calibration.rows, calibration.cols, model.colour_degree, model.slope_max)
    key = (*size, model.coefficients.tobytes(), start)
    if key in _tables:
        _tables.move_to_end(key)
        return _tables[key]
    found = freeze(_inverted(calibration, usual_change))
    _tables[key] = found
    while len(_tables) > _KEPT:
        _tables.popitem(last=False)
    return found


def _inverted(calibration: Calibration, usual_change: Usual | None) -> Floats:
    from pipeline.calibration.rendering_kernels import invert

    model = calibration.model
    half = max(calibration.rows, calibration.cols)
    v, u = (
        np.linspace(-size / half, size / half, n)
        for size, n in zip((calibration.rows, calibration.cols), _PLACES, strict=True)
    )
    degree = model.position_degree + 1
    down, across = (np.stack([w**k for k in range(degree)]) for w in (v, u))  # (powers, nodes)
    tables = np.einsum("jv,iu,jims->vums", down, across, model.coefficients.astype(np.float64))
    grid = np.linspace(-model.slope_max, model.slope_max, _SLOPES)
    out = _guess(usual_change, u, v, grid)
    steps = _STEPS if usual_change is None else 1
    flat = np.ascontiguousarray(tables.reshape(-1, *tables.shape[2:]))
    invert(flat, slope_model.powers(model.colour_degree), model.colour_degree, grid, steps, out)
    if not np.isfinite(out).all():
        raise CalibrationError("the calibration cannot be turned round into colours; calibrate again")
    return out.reshape(*_PLACES, _SLOPES, _SLOPES, 3)


def _guess(usual_change: Usual | None, u: Doubles, v: Doubles, grid: Doubles) -> Floats:
    """Colours (places, n, n, 3) from which the inversion starts."""
    if usual_change is None:
        return np.zeros((len(u) * len(v), len(grid), len(grid), 3), np.float32)
    at_v, at_u, gy, gx = (a.ravel() for a in np.meshgrid(v, u, grid, grid, indexing="ij"))
    start = np.einsum("nps,psk->nk", _terms(gx, gy, at_u, at_v), usual_change.coefficients.astype(np.float64))
    return start.reshape(len(u) * len(v), len(grid), len(grid), 3).astype(np.float32)


def _blurred(change: Floats, sensor: SensorSpec) -> Floats:
    import cv2

    width = optics.optics_of(sensor).blur_px
    return np.asarray(cv2.GaussianBlur(change, (0, 0), width), np.float32) if width > 0 else change


def _taken_apart(reference: Image, markers: Markers | None, pixel_mm: float) -> Printed:
    light = reference.astype(np.float32)
    if markers is None:
        return Printed(plain=light, share=np.ones_like(light))
    reach = max(1.0, markers.radius_mm / pixel_mm / 2)
    plain = inpainted(light, marker_mask(reference, markers, pixel_mm), reach)
    share: Floats = np.divide(light, np.maximum(plain, 1.0), dtype=np.float32)
    return Printed(plain=plain, share=share)


def _moved(share: Floats, move_x: Floats, move_y: Floats) -> Floats:
    import cv2

    rows, cols = share.shape[:2]
    x = np.arange(cols, dtype=np.float32)[None, :] - move_x
    y = np.arange(rows, dtype=np.float32)[:, None] - move_y
    warped = cv2.remap(share, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(warped, np.float32)
