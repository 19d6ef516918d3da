"""A user's own look-up as the simulator's optics: the picture that a calibrated sensor would take of a surface.

`calibrate balls` gives slopes from colours. Here it is turned round: at nodes of place and slope, the colour change
nearest to none whose slope is the one asked for (three colours answer two slopes, so one must choose), found by Newton
steps that lead there from level ground. Between the nodes the table is linear.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline import slope_model
from pipeline.arrays import Floats, Image, freeze
from pipeline.calibration import Calibration
from pipeline.errors import CalibrationError, ShapeError
from pipeline.markers import inpainted, marker_mask
from pipeline.physics import optics, optics_markers
from pipeline.sensors.spec import Markers, SensorSpec

_PLACES = (7, 9)  # nodes down and across; the slope model is a low polynomial of the place
_SLOPES = 33  # nodes along each slope
_STEPS = 8
_KEPT = 4  # tables of the last few calibrations

_tables: OrderedDict[tuple[object, ...], Floats] = OrderedDict()


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
) -> Image:
    """The picture (rows, cols, 3) that the sensor whose untouched picture is `reference` takes of its surface.

    Blur, noise and the motion of markers are those of `sensor`; markers keep the look they have in `reference`.
    Raises CalibrationError or ShapeError when calibration, reference, surface and sensor do not belong together.
    """
    from pipeline.calibration import check_for

    check_for(calibration, sensor.name, reference)
    if reference.shape != (*sensor.camera.shape, 3):
        raise ShapeError(f"the reference of {sensor.name} must be {(*sensor.camera.shape, 3)}, got {reference.shape}")
    optics_markers.checked(sensor, indentation_mm, shear_mm)
    still = _taken_apart(reference, sensor.markers, calibration.pixel_mm)
    change = _blurred(
        colour_change(calibration, still.plain, *optics.slopes(indentation_mm, calibration.pixel_mm)), sensor
    )
    light = still.plain + change
    if sensor.markers is not None:
        light *= _moved(still.share, *optics_markers.marker_motion_px(sensor, indentation_mm, shear_mm))
    return freeze(optics.recorded(light, optics.optics_of(sensor).noise_grey, seed))


def colour_change(
    calibration: Calibration, reference: NDArray[np.generic], gx: NDArray[np.floating], gy: NDArray[np.floating]
) -> Floats:
    """Grey levels (rows, cols, 3) that the slopes (rows, cols), mm/mm, add to `reference`; 0 on level ground.

    `calibration.slopes` of the changed picture gives the slopes back, up to the steepest that the calibration knows.
    """
    from pipeline.physics.lookup_kernels import look_up

    if gx.shape != (calibration.rows, calibration.cols) or gy.shape != gx.shape:
        raise ShapeError(f"slopes must have the shape {(calibration.rows, calibration.cols)}, got {gx.shape}")
    out = np.empty((*gx.shape, 3), np.float32)
    x, y = (np.ascontiguousarray(g, dtype=np.float32) for g in (gx, gy))
    look_up(x, y, table(calibration), np.float32(calibration.model.slope_max), out)
    return out / slope_model.gain(reference)


def table(calibration: Calibration) -> Floats:
    """Colour changes (v, u, slopes down, slopes right, 3), relative as in `slope_model`; kept for the last few."""
    model = calibration.model
    key = (calibration.rows, calibration.cols, model.colour_degree, model.slope_max, model.coefficients.tobytes())
    if key in _tables:
        _tables.move_to_end(key)
        return _tables[key]
    found = freeze(_inverted(calibration))
    _tables[key] = found
    while len(_tables) > _KEPT:
        _tables.popitem(last=False)
    return found


def _inverted(calibration: Calibration) -> Floats:
    from pipeline.physics.lookup_kernels import invert

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
    out = np.zeros((_PLACES[0] * _PLACES[1], _SLOPES, _SLOPES, 3), np.float32)
    flat = np.ascontiguousarray(tables.reshape(-1, *tables.shape[2:]))
    invert(flat, slope_model.powers(model.colour_degree), model.colour_degree, grid, _STEPS, out)
    if not np.isfinite(out).all():
        raise CalibrationError("the calibration cannot be turned round into colours; calibrate again")
    return out.reshape(*_PLACES, _SLOPES, _SLOPES, 3)


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
