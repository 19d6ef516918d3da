"""How a gel's slopes become colour: untouched picture, colour change, and the rendered touch.

A slope (gx, gy) of the indentation tilts the surface normal, seen from the camera, to (-gx, -gy, 1). Each LED adds to
a pixel what the tilt makes it face the light more (Lambert), and takes what it makes it face away, down to its own
shadow. Light weakens from the LED's own side to the far side of the image, and towards the corners (vignette).
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Floats, Image, freeze
from pipeline.camera import Camera
from pipeline.errors import SettingProblem, ShapeError
from pipeline.sensors.spec import Gel, Markers, Optics, SensorSpec

_SHEAR_PER_THICKNESS = 0.15  # how far markers are squeezed out of a dent, per gel thickness and unit of slope
_COARSE = 4  # the squeeze is smooth: every 4th pixel carries it


def colour_change(sensor: SensorSpec, gx: NDArray[np.floating], gy: NDArray[np.floating]) -> Floats:
    """Grey levels (rows, cols, 3) float32 that the slopes add to the untouched picture; exactly 0 on level ground.

    gx, gy (rows, cols): d indentation_mm / dx (right) and / dy (down), in mm/mm. NaN slopes give NaN.
    """
    from pipeline.physics.optics_kernels import lambert_change

    optics = optics_of(sensor)
    if gx.shape != sensor.camera.shape or gy.shape != gx.shape:
        raise ShapeError(f"slopes must have the shape {sensor.camera.shape} of {sensor.name}, got {gx.shape}")
    leds, strength = _lamps(optics, sensor.camera)
    out = np.empty((*gx.shape, 3), np.float32)
    lambert_change(_single(gx), _single(gy), leds, strength, np.float32(optics.vignette), out)
    return freeze(out)


def slopes(indentation_mm: NDArray[np.floating], pixel_mm: float) -> tuple[Floats, Floats]:
    """(d/dx, d/dy) in mm/mm of a height image (rows, cols): central differences, one-sided at the border."""
    from pipeline.physics import optics_kernels

    height = _single(indentation_mm)
    gx, gy = np.empty_like(height), np.empty_like(height)
    optics_kernels.slopes(height, np.float32(pixel_mm), gx, gy)
    return gx, gy


def untouched(sensor: SensorSpec) -> Image:
    """The picture (rows, cols, 3) of the sensor while nothing touches it, without noise; kept per sensor."""
    return _untouched(sensor.camera, optics_of(sensor), sensor.markers, sensor.pixel_mm)


def render(sensor: SensorSpec, indentation_mm: NDArray[np.floating], *, seed: int | None) -> Image:
    """The picture (rows, cols, 3) that a gel sensor takes of its pushed-in surface.

    Slopes -> colour -> markers that move with the surface -> lens blur -> camera noise (none if `seed` is None).
    """
    optics = optics_of(sensor)
    if indentation_mm.shape != sensor.camera.shape:
        raise ShapeError(
            f"an indentation of {sensor.name} must have the shape {sensor.camera.shape}, got {indentation_mm.shape}"
        )
    if not np.isfinite(indentation_mm).all():
        raise ShapeError("an indentation to render must be finite; fill its gaps first")
    light = colour_change(sensor, *slopes(indentation_mm, sensor.pixel_mm)) + _glow(sensor.camera, optics)
    if sensor.markers is not None and sensor.gel is not None:
        move = _marker_motion_px(_single(indentation_mm), sensor.camera, sensor.gel, sensor.pixel_mm)
        _print(light, sensor.markers, sensor.pixel_mm, *move)
    return freeze(_expose(light, optics, seed))


def optics_of(sensor: SensorSpec) -> Optics:
    """The sensor's optics; raises SettingProblem for one that takes no colour picture."""
    if sensor.optics is None:
        raise SettingProblem(f"{sensor.name} takes no colour pictures; choose a gel sensor")
    return sensor.optics


def _single(array: NDArray[np.floating]) -> Floats:
    return np.ascontiguousarray(array, dtype=np.float32)


@lru_cache(maxsize=32)
def _lamps(optics: Optics, camera: Camera) -> tuple[Floats, Floats]:
    """Light directions and colours (n, 6), and how each weakens over the image (n, 3), as the kernel wants them."""
    half_w, half_h = camera.cols / 2, camera.rows / 2
    lamps, strength = [], []
    for led in optics.leds:
        azimuth, elevation = math.radians(led.azimuth_deg), math.radians(led.elevation_deg)
        cos_a, sin_a = math.cos(azimuth), math.sin(azimuth)
        lamps.append((math.cos(elevation) * cos_a, math.cos(elevation) * sin_a, math.sin(elevation), *led.rgb))
        # The share is 1 at the LED's own side and 1 - falloff at the far one, linear between.
        per_px = 0.5 * optics.falloff / (half_w * abs(cos_a) + half_h * abs(sin_a))
        first = 1.0 - 0.5 * optics.falloff - per_px * ((half_w - 0.5) * cos_a + (half_h - 0.5) * sin_a)
        strength.append((first, per_px * cos_a, per_px * sin_a))
    return freeze(np.array(lamps, np.float32)), freeze(np.array(strength, np.float32))


@lru_cache(maxsize=32)
def _glow(camera: Camera, optics: Optics) -> Floats:
    """The untouched light (rows, cols, 3) before markers and blur."""
    x = ((np.arange(camera.cols) + 0.5) / camera.cols * 2 - 1)[None, :]
    y = ((np.arange(camera.rows) + 0.5) / camera.rows * 2 - 1)[:, None]
    light = np.empty((*camera.shape, 3))
    light[:] = optics.base_rgb
    for glow in optics.glows:
        lobe = np.exp(-(((x - glow.x) / glow.width) ** 2) - ((y - glow.y) / glow.height) ** 2)
        light += lobe[..., None] * np.array(glow.rgb)
    lens = 1.0 - optics.vignette * ((x * x + y * y) / 2) ** 2
    return freeze((light * lens[..., None]).astype(np.float32))


@lru_cache(maxsize=32)
def _untouched(camera: Camera, optics: Optics, markers: Markers | None, pixel_mm: float) -> Image:
    light = _glow(camera, optics).copy()
    if markers is not None:
        still = np.zeros(camera.shape, np.float32)
        _print(light, markers, pixel_mm, still, still)
    return freeze(_expose(light, optics, None))


def _print(light: Floats, markers: Markers, pixel_mm: float, move_x: Floats, move_y: Floats) -> None:
    from pipeline.physics.optics_kernels import print_markers

    sizes = (markers.pitch_mm / pixel_mm, markers.radius_mm / pixel_mm, 0.5 * markers.twin_mm / pixel_mm)
    print_markers(light, move_x, move_y, *(np.float32(s) for s in (*sizes, markers.darkness)))


def _marker_motion_px(u_mm: Floats, camera: Camera, gel: Gel, pixel_mm: float) -> tuple[Floats, Floats]:
    """How far (x, y) the surface points now at each pixel have moved in the image.

    A point that comes nearer to the camera moves outward from the optical axis; a dent squeezes its flanks outward.
    """
    import cv2

    rest_mm = pixel_mm * camera.fx_px
    nearer = u_mm / np.float32(rest_mm)
    x = np.arange(camera.cols, dtype=np.float32) - np.float32(camera.cx_px)
    y = np.arange(camera.rows, dtype=np.float32) - np.float32(camera.cy_px)
    small = cv2.resize(u_mm, None, fx=1 / _COARSE, fy=1 / _COARSE, interpolation=cv2.INTER_AREA)
    small = cv2.GaussianBlur(small, (0, 0), max(0.5 * gel.thickness_mm / (pixel_mm * _COARSE), 0.1))
    gx, gy = slopes(np.asarray(small, np.float32), pixel_mm * _COARSE)
    reach = np.float32(-_SHEAR_PER_THICKNESS * gel.thickness_mm / pixel_mm)
    out_x, out_y = (cv2.resize(reach * g, (camera.cols, camera.rows), interpolation=cv2.INTER_LINEAR) for g in (gx, gy))
    return _single(nearer * x[None, :] + out_x), _single(nearer * y[:, None] + out_y)


def _expose(light: Floats, optics: Optics, seed: int | None) -> Image:
    """Lens blur, noise and 8 bits."""
    import cv2

    picture: Floats = light
    if optics.blur_px > 0:
        picture = np.asarray(cv2.GaussianBlur(light, (0, 0), optics.blur_px), np.float32)
    if seed is not None and optics.noise_grey > 0:
        noise = np.random.default_rng(seed).standard_normal(light.shape, np.float32)
        picture = _single(picture + np.float32(optics.noise_grey) * noise)
    return np.clip(np.rint(picture), 0, 255).astype(np.uint8)
