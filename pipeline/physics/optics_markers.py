"""Markers of a gel: their motion, and how they darken the image."""

import math

import numpy as np
from numpy.typing import NDArray

from pipeline.core.arrays import Floats, freeze
from pipeline.core.errors import SettingProblem, ShapeError
from pipeline.core.geometry.camera import Camera
from pipeline.physics.slopes import compute_slopes
from pipeline.sensors.parts import Gel, Markers
from pipeline.sensors.spec import SensorSpec

_SHEAR_PER_THICKNESS = 0.15  # motion of markers out of a dent, per gel thickness and unit of slope
_COARSE = 4  # pixels to a node: the motion is smooth


def compute_marker_motion_px(
    sensor: SensorSpec,
    indentation_mm: NDArray[np.floating],
    shear_mm: NDArray[np.floating] | None = None,
) -> tuple[Floats, Floats]:
    """Motion (x, y), each (rows, cols) in pixels, of the surface point at each pixel since the
    reference image.
    """
    if sensor.gel is None:
        raise SettingProblem(f"{sensor.name} has no gel with markers; choose a gel sensor")
    check_surface(sensor, indentation_mm, shear_mm)
    x, y = _compute_pressed_motion(
        np.ascontiguousarray(indentation_mm, dtype=np.float32),
        sensor.camera,
        sensor.gel,
        sensor.pixel_mm,
    )
    if shear_mm is None:
        return freeze(x), freeze(y)
    dragged = (shear_mm / sensor.pixel_mm).astype(np.float32)
    return freeze(x + dragged[..., 0]), freeze(y + dragged[..., 1])


def check_surface(
    sensor: SensorSpec, indentation_mm: NDArray[np.floating], shear_mm: NDArray[np.floating] | None
) -> None:
    """Raise ShapeError unless both have the shape of the sensor's image and are finite."""
    shape = sensor.camera.shape
    if indentation_mm.shape != shape:
        raise ShapeError(
            f"an indentation of {sensor.name} must have the shape {shape}, got "
            f"{indentation_mm.shape}"
        )
    if shear_mm is not None and shear_mm.shape != (*shape, 2):
        raise ShapeError(
            f"a shear of {sensor.name} must have the shape {(*shape, 2)}, got {shear_mm.shape}"
        )
    if not np.isfinite(indentation_mm).all() or (
        shear_mm is not None and not np.isfinite(shear_mm).all()
    ):
        raise ShapeError("indentation and shear must be finite to be rendered; fill gaps first")


def draw_markers(
    light: Floats, markers: Markers, pixel_mm: float, move_x: Floats, move_y: Floats
) -> None:
    """Darken `light` (rows, cols, 3) at the dots.

    Motions (rows, cols) are those of `compute_marker_motion_px`.
    """
    from pipeline.physics.optics_kernels import darken_markers

    angle = math.radians(markers.rotation_deg)
    first = (markers.phase_mm[0] / pixel_mm, markers.phase_mm[1] / pixel_mm)
    place = np.array((*first, math.cos(angle), math.sin(angle), markers.distortion), np.float32)
    sizes = (
        markers.pitch_mm / pixel_mm,
        markers.radius_mm / pixel_mm,
        0.5 * markers.doubling_mm / pixel_mm,
    )
    pitch, radius, half_twin, darkness, jitter = (
        np.float32(n) for n in (*sizes, markers.darkness, markers.jitter_mm / pixel_mm)
    )
    darken_markers(light, move_x, move_y, pitch, radius, half_twin, darkness, jitter, place)


def _compute_pressed_motion(
    u_mm: Floats, camera: Camera, gel: Gel, pixel_mm: float
) -> tuple[Floats, Floats]:
    """Motion (x, y) in pixels by pressing alone.

    A point that comes closer to the camera moves outward from the optical axis; a dent pushes its
    flanks outward.
    """
    import cv2

    rest_mm = pixel_mm * camera.fx_px
    nearer = u_mm / np.float32(rest_mm)
    x = np.arange(camera.cols, dtype=np.float32) - np.float32(camera.cx_px)
    y = np.arange(camera.rows, dtype=np.float32) - np.float32(camera.cy_px)
    small = cv2.resize(u_mm, None, fx=1 / _COARSE, fy=1 / _COARSE, interpolation=cv2.INTER_AREA)
    small = cv2.GaussianBlur(small, (0, 0), max(0.5 * gel.thickness_mm / (pixel_mm * _COARSE), 0.1))
    gx, gy = compute_slopes(np.asarray(small, np.float32), pixel_mm * _COARSE)
    reach = np.float32(-_SHEAR_PER_THICKNESS * gel.thickness_mm / pixel_mm)
    size = (camera.cols, camera.rows)
    out_x, out_y = (
        np.asarray(cv2.resize(reach * g, size, interpolation=cv2.INTER_LINEAR), np.float32)
        for g in (gx, gy)
    )
    move_x: Floats = np.add(nearer * x[None, :], out_x, dtype=np.float32)
    return move_x, np.add(nearer * y[:, None], out_y, dtype=np.float32)
