"""Rendering of gels: reference image, colour change by slopes, and the image of a touch.

A slope (gx, gy) of the indentation tilts the surface normal, seen from the camera, to (-gx, -gy,
1). Each LED's light on a pixel changes with the cosine to the tilted normal (Lambert), down to zero
(attached shadow). Light falls off from the LED's side to the far side of the image, and toward the
corners (vignette). Where a dent stands between an LED and a point, that LED's light is missing
there (cast shadow).

Markers of a gel: their motion, and how they darken the image.

Slopes of height images.
"""

import math
from collections.abc import Iterator

import numpy as np

from pipeline.core.arrays import Floats, Image, Reals, freeze
from pipeline.core.derived import derive_once
from pipeline.core.errors import SettingProblem, ShapeError
from pipeline.core.geometry.camera import Camera
from pipeline.sensors.parts import Gel, Markers, Optics, compute_reference_light
from pipeline.sensors.spec import SensorSpec


def compute_slopes(height_mm: Reals, pixel_mm: float) -> tuple[Floats, Floats]:
    """(d/dx, d/dy) in mm/mm of height images (..., rows, cols): central differences, one-sided
    at the border.
    """
    from pipeline.physics.slope_kernels import write_slopes

    # writable: the kernel is compiled again for read-only arrays
    height = np.require(height_mm, np.float32, ("C", "W"))
    gx = np.empty_like(height)
    gy = np.empty_like(height)
    images, out_x, out_y = (a.reshape(-1, *height.shape[-2:]) for a in (height, gx, gy))
    write_slopes(images, np.float32(1.0) / np.float32(pixel_mm), out_x, out_y)
    return gx, gy


_SHEAR_PER_THICKNESS = 0.15  # motion of markers out of a dent, per gel thickness and unit of slope
_COARSE = 4  # pixels to a node: the motion is smooth


def compute_marker_motion_px(
    sensor: SensorSpec,
    indentation_mm: Reals,
    shear_mm: Reals | None = None,
) -> tuple[Floats, Floats]:
    """Motion (x, y), each (rows, cols) in pixels, of the surface point at each pixel since the
    reference image.
    """
    if sensor.gel is None:
        raise SettingProblem(f"{sensor.name} has no gel with markers; choose a gel sensor")
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


def check_surface(sensor: SensorSpec, indentation_mm: Reals, shear_mm: Reals | None) -> None:
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


_PENUMBRA_MM = 0.25  # depth below an LED's light at which a point is fully in shadow
_NO_SHADOW_MM = 0.02  # shallower surfaces cast no visible shadow
_N_QUANTILES = 4096


def compute_colour_change(sensor: SensorSpec, gx: Reals, gy: Reals) -> Floats:
    """Grey levels (rows, cols, 3) float32 that the slopes add to the reference image.

    Exactly 0 for zero slopes.

    gx, gy (rows, cols): d indentation_mm / dx (right) and / dy (down), in mm/mm. NaN slopes give
    NaN.
    """
    optics = require_optics(sensor)
    rows, cols = gx.shape
    gx = gx.astype(np.float32)
    gy = gy.astype(np.float32)
    one = np.float32(1.0)
    x = np.arange(cols, dtype=np.float32)
    y = np.arange(rows, dtype=np.float32)[:, None]
    across = (2 * x + 1) / np.float32(cols) - 1
    down = (2 * y + 1) / np.float32(rows) - 1
    lens = one - np.float32(optics.vignette) * ((across * across + down * down) / 2) ** 2
    normal = one / np.sqrt(one + gx * gx + gy * gy)
    out = np.zeros((rows, cols, 3), np.float32)
    for led, (first, per_x, per_y) in zip(*pack_leds(optics, sensor.camera), strict=True):
        facing = np.maximum((led[2] - gx * led[0] - gy * led[1]) * normal, 0) - led[2]
        out += (lens * facing * ((first + per_x * x + per_y * y) / (one - led[2])))[
            ..., None
        ] * led[3:]
    return freeze(out)


def render_reference(sensor: SensorSpec) -> Image:
    """The reference image (rows, cols, 3) of a sensor without noise, cached."""
    return _render_reference(sensor.camera, require_optics(sensor), sensor.markers, sensor.pixel_mm)


def render(
    sensor: SensorSpec,
    indentation_mm: Reals,
    *,
    seed: int | None,
    shear_mm: Reals | None = None,
) -> Image:
    """The image (rows, cols, 3) of a gel sensor under an indentation (rows, cols) in mm.

    Slopes -> colour -> cast shadows -> markers that move with the surface -> lens blur -> camera
    noise (none if `seed` is None). `shear_mm` (rows, cols, 2): motion of the material at each
    pixel, right and down, by a tangential load (`shear.solve_shear`).
    """
    optics = require_optics(sensor)
    check_surface(sensor, indentation_mm, shear_mm)
    height_mm = _to_float32(indentation_mm)
    light = _render_light(sensor, optics, height_mm)
    if sensor.markers is not None and sensor.gel is not None:
        move = compute_marker_motion_px(sensor, indentation_mm, shear_mm)
        draw_markers(light, sensor.markers, sensor.pixel_mm, *move)
    return freeze(_expose(light, optics, seed))


def require_optics(sensor: SensorSpec) -> Optics:
    """The sensor's optics; raises SettingProblem for a sensor without colour images."""
    if sensor.optics is None:
        raise SettingProblem(f"{sensor.name} has no colour images; choose a gel sensor")
    return sensor.optics


def _to_float32(array: Reals) -> Floats:
    """A contiguous float32 array, read-only: kernels are compiled again for writable ones."""
    return freeze(np.ascontiguousarray(array, dtype=np.float32).view())


def pack_leds(optics: Optics, camera: Camera) -> tuple[Floats, Floats]:
    """Light directions and colours (n, 6), and falloff over the image (n, 3), for the kernels.

    Padded to n = 3 k.
    """
    half_w = camera.cols / 2
    half_h = camera.rows / 2
    directions = []
    strength = []
    for led in optics.leds:
        azimuth = math.radians(led.azimuth_deg)
        elevation = math.radians(led.elevation_deg)
        cos_a = math.cos(azimuth)
        sin_a = math.sin(azimuth)
        flat = math.cos(elevation)
        directions.append((flat * cos_a, flat * sin_a, math.sin(elevation), *led.rgb))
        # The strength is 1 at the LED's side and 1 - falloff at the far side, linear between.
        per_px = 0.5 * optics.falloff / (half_w * abs(cos_a) + half_h * abs(sin_a))
        first = (
            1.0 - 0.5 * optics.falloff - per_px * ((half_w - 0.5) * cos_a + (half_h - 0.5) * sin_a)
        )
        strength.append((first, per_px * cos_a, per_px * sin_a))
    while len(directions) % 3:  # the kernel takes three at a time
        directions.append((0.0,) * 6)
        strength.append((0.0,) * 3)
    return freeze(np.array(directions, np.float32)), freeze(np.array(strength, np.float32))


@derive_once
def _render_reference(
    camera: Camera, optics: Optics, markers: Markers | None, pixel_mm: float
) -> Image:
    light = compute_reference_light(camera, optics).copy()
    if markers is not None:
        no_motion = freeze(np.zeros(camera.shape, np.float32))
        draw_markers(light, markers, pixel_mm, no_motion, no_motion)
    return freeze(_expose(light, optics, None))


def _render_light(sensor: SensorSpec, optics: Optics, height_mm: Floats) -> Floats:
    """The light (rows, cols, 3) of a surface before markers and blur."""
    from pipeline.physics.optics_kernels import render_light

    camera = sensor.camera
    light = compute_reference_light(camera, optics).reshape(camera.rows, -1).copy()
    render_light(
        height_mm,
        np.float32(sensor.pixel_mm),
        *pack_leds(optics, camera),
        np.float32(optics.vignette),
        light,
    )
    light = light.reshape(*camera.shape, 3)
    if optics.shadow > 0 and float(height_mm.max()) > _NO_SHADOW_MM:
        apply_shadows(light, optics, sensor.camera, height_mm, sensor.pixel_mm)
    return light


def apply_shadows(
    light: Floats, optics: Optics, camera: Camera, height_mm: Floats, pixel_mm: float
) -> None:
    """Darken `light` (rows, cols, 3) in place by the shadows that an indentation casts, LED by
    LED.
    """
    from pipeline.physics.optics_kernels import darken

    leds = pack_leds(optics, camera)[0][: len(optics.leds)]
    all_leds = np.maximum(leds[:, 3:].sum(axis=0), 1e-6)
    sinks = np.full(len(leds), math.tan(math.radians(optics.shadow_deg)))
    for led, cover in zip(
        leds, iterate_led_shadows(height_mm, leds[:, :2], sinks, pixel_mm), strict=True
    ):
        darken(light, cover, np.float32(optics.shadow) * led[3:] / all_leds)


def iterate_led_shadows(
    height_mm: Floats, towards: Reals, sinks: Reals, pixel_mm: float
) -> Iterator[Floats]:
    """LED by LED, the share (rows, cols) of its light, 0 to 1, that an indentation blocks.

    towards (n, 2): directions toward the LEDs in the image, of any length; sinks (n,): descent of
    their light in mm per mm of path. The yielded array is overwritten by the next LED's.
    """
    from pipeline.physics.optics_kernels import cast_shadow

    height_mm, turned = _to_float32(height_mm), _to_float32(height_mm.T)
    cover = np.empty_like(height_mm)
    cover_turned = np.empty_like(turned)
    lines = np.empty((2, max(height_mm.shape) + 4), np.float32)
    for (x, y), sink in zip(towards, sinks, strict=True):
        length = np.float32(math.hypot(x, y) or 1.0)
        drop = np.float32(pixel_mm * sink)
        to_x = np.float32(x) / length
        to_y = np.float32(y) / length
        if abs(to_x) >= abs(to_y):
            cast_shadow(turned, to_y, to_x, drop, np.float32(_PENUMBRA_MM), lines, cover_turned)
            cover[:] = cover_turned.T
        else:
            cast_shadow(height_mm, to_x, to_y, drop, np.float32(_PENUMBRA_MM), lines, cover)
        yield cover


def _expose(light: Floats, optics: Optics, seed: int | None) -> Image:
    """Lens blur, noise and 8 bits."""
    import cv2

    blurred: Floats = light
    if optics.blur_px > 0:
        blurred = np.asarray(cv2.GaussianBlur(light, (0, 0), optics.blur_px), np.float32)
    return digitise_light(blurred, optics.noise_grey, seed)


def digitise_light(light: Floats, noise_grey: float, seed: int | None) -> Image:
    """The 8-bit image of `light` (rows, cols, 3), with the noise of `seed` unless None."""
    from pipeline.physics.optics_kernels import digitise

    if seed is None or noise_grey <= 0:
        return np.clip(light + np.float32(0.5), 0, 255).astype(np.uint8)
    out = np.empty(light.shape, np.uint8)
    digitise(light, _normal_quantiles(), np.float32(noise_grey), np.uint64(seed % 2**64), out)
    return out


def _normal_quantiles() -> Floats:
    """Quantiles of the standard normal distribution, scaled to standard deviation 1."""
    from scipy.special import ndtri

    values = ndtri((np.arange(_N_QUANTILES) + 0.5) / _N_QUANTILES)
    return freeze((values / values.std()).astype(np.float32))
