"""The pictures that a random unit takes, untouched and touched, and all that can befall them on the way.

Between the two the light may have drifted, the camera may have moved by a pixel or two; both may be noisy, blurred,
coarse, compressed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from pipeline.base.arrays import Floats, Image, Mask, freeze
from pipeline.physics import optics
from pipeline.physics.optics_markers import compute_marker_motion_px, draw_markers
from pipeline.physics.slopes import compute_slopes
from pipeline.simulation.random_gel_sensors import RandomGelSensor

_WHITE = 1 << 22  # numbers that camera noise is cut from: drawing them anew takes longer than the light


@dataclass(frozen=True, slots=True, kw_only=True)
class ImageDrift:
    """What has changed between the untouched picture and the other, beside the touch."""

    gain: Floats  # (3,)
    patches: Floats  # (5, 6, 3) shares by which the light has changed over the picture, coarse
    ramp_grey: Floats  # (3, 3) of each colour: over the picture's width, its height, and toward its corners
    shift_px: tuple[float, float]


NO_DRIFT = ImageDrift(
    gain=np.ones(3, np.float32),
    patches=np.zeros((5, 6, 3), np.float32),
    ramp_grey=np.zeros((3, 3), np.float32),
    shift_px=(0.0, 0.0),
)


def sample_drift(rng: np.random.Generator, strength: float) -> ImageDrift:
    """A random drift; strength 1: gain off by a tenth, ramps of 20 grey levels, a shift of a pixel and a half."""
    gain = 1.0 + strength * (rng.uniform(-0.1, 0.1) + rng.normal(0.0, 0.015, 3))
    ramp = strength * (rng.uniform(-20.0, 20.0, (3, 1)) + rng.normal(0.0, 5.0, (3, 3))) * (rng.random((3, 1)) < 0.7)
    shift = strength * rng.uniform(-1.5, 1.5, 2) * (rng.random() < 0.6)
    patches = strength * 0.06 * rng.random() * (rng.normal(0.0, 1.0, (5, 6, 1)) + rng.normal(0.0, 0.5, (5, 6, 3)))
    return ImageDrift(
        patches=patches.astype(np.float32),
        gain=gain.astype(np.float32),
        ramp_grey=ramp.T.astype(np.float32),
        shift_px=(float(shift[0]), float(shift[1])),
    )


def render_image_pair(
    rng: np.random.Generator, of: RandomGelSensor, indentation_mm: Floats, contact: Mask, drifted: ImageDrift
) -> tuple[Image, Image]:
    """(touched, untouched), each (rows, cols, 3) of 8 bits."""
    still = np.zeros_like(indentation_mm)
    grain = _grain(rng, of.sensor.camera.shape) * np.float32(of.grain_grey)
    blur = optics.require_optics(of.sensor).blur_px
    touched, untouched = (np.maximum(_light(of, z) + grain, 0.0) for z in (indentation_mm, still))
    if of.sensor.markers is not None:
        shear = _shear_mm(rng, contact)
        draw_markers(
            touched, of.sensor.markers, of.sensor.pixel_mm, *compute_marker_motion_px(of.sensor, indentation_mm, shear)
        )
        draw_markers(untouched, of.sensor.markers, of.sensor.pixel_mm, still, still)
    exposure = _exposure(rng, untouched, of.exposure)
    touched, untouched = (_toned(light * exposure, of.gamma) for light in (touched, untouched))
    film = _Film(rng)
    return (
        film.expose(rng, _blurred(_drifted(touched, drifted), blur), 1.0),
        film.expose(rng, _blurred(untouched, blur), float(rng.choice((1.0, 0.3)))),
    )


def _light(of: RandomGelSensor, height_mm: Floats) -> Floats:
    """The light (rows, cols, 3) of a surface as the camera's colours see it, before markers and lens."""
    import cv2

    still = of.reference_light
    if not height_mm.any():
        return np.maximum(still @ of.colour_mixing.T.astype(np.float32), 0.0)
    change = optics.compute_colour_change(of.sensor, *compute_slopes(height_mm, of.sensor.pixel_mm))
    if of.falloff_from_reference > 0:
        bright = np.clip(still, 4.0, None)
        change = change * (bright / bright.mean(axis=(0, 1))) ** np.float32(of.falloff_from_reference)
    light = np.asarray(still + change, np.float32)
    if optics.require_optics(of.sensor).shadow > 0:
        optics.apply_shadows(light, of.sensor, height_mm, of.sensor.pixel_mm)
    share, reach_mm = of.scattered_light
    if share:
        small = cv2.resize(light - still, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA)
        wide = cv2.resize(
            cv2.GaussianBlur(small, (0, 0), 0.25 * reach_mm / of.sensor.pixel_mm),
            light.shape[1::-1],
            interpolation=cv2.INTER_LINEAR,
        )
        light += np.float32(share) * wide
    light *= (1.0 + np.float32(of.brightening_per_mm) * height_mm)[..., None]
    return np.maximum(light @ of.colour_mixing.T.astype(np.float32), 0.0)


def _shear_mm(rng: np.random.Generator, contact: Mask) -> Floats | None:
    """A drag of the gel's surface along with what touches it."""
    import cv2

    if rng.random() < 0.5 or not contact.any():
        return None
    small = cv2.resize(contact.astype(np.float32), None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA)
    small = cv2.GaussianBlur(small, (0, 0), float(rng.uniform(3.0, 16.0)))
    around = cv2.resize(small, contact.shape[::-1], interpolation=cv2.INTER_LINEAR)
    return np.asarray(around[..., None] * rng.normal(0.0, 0.25, 2), np.float32)


def _grain(rng: np.random.Generator, shape: tuple[int, int]) -> Floats:
    """The coating's own structure (rows, cols, 1), standard deviation 1."""
    fields = _noise_bank()
    row, col = rng.integers(0, fields.shape[1] - shape[0]), rng.integers(0, fields.shape[2] - shape[1])
    return fields[rng.integers(len(fields)), row : row + shape[0], col : col + shape[1], None]


@lru_cache(maxsize=1)
def _white() -> Floats:
    return np.random.default_rng(21).standard_normal(_WHITE, np.float32)


@lru_cache(maxsize=1)
def _noise_bank() -> Floats:
    import cv2

    rng, fields = np.random.default_rng(20), []
    for grain in (0.8, 1.5, 2.5, 5.0, 8.0):
        field = cv2.GaussianBlur(rng.normal(0.0, 1.0, (400, 500)).astype(np.float32), (0, 0), grain)
        fields.append(field / field.std())
    return np.array(fields, np.float32)


def _exposure(rng: np.random.Generator, light: Floats, wanted: float) -> np.float32:
    """A camera's exposure: as wanted, yet never black, seldom so bright that much of the picture is clipped."""
    some = light[::4, ::4]
    wanted = max(wanted, 50.0 / max(float(np.quantile(some, 0.9)), 1.0))
    most = 245.0 / max(float(np.quantile(some, 0.97)), 1.0)
    return np.float32(min(wanted, most) if rng.random() < 0.9 else wanted)


def _toned(light: Floats, tone: float) -> Floats:
    """The camera's response: middle grey stays."""
    if tone == 1.0:
        return light
    return np.asarray(100.0 * (light * np.float32(0.01)) ** np.float32(tone), np.float32)


def _drifted(light: Floats, by: ImageDrift) -> Floats:
    import cv2

    if by is NO_DRIFT:
        return light
    rows, cols = light.shape[:2]
    x, y = (
        np.linspace(-0.5, 0.5, cols, dtype=np.float32)[None, :, None],
        np.linspace(-0.5, 0.5, rows, dtype=np.float32)[:, None, None],
    )
    ramp = x * by.ramp_grey[0] + y * by.ramp_grey[1] + 2.0 * (x * x + y * y) * by.ramp_grey[2]
    share = by.gain + cv2.resize(by.patches, (cols, rows), interpolation=cv2.INTER_CUBIC)
    light = np.asarray(light * share + ramp, np.float32)
    if by.shift_px == (0.0, 0.0):
        return light
    move = np.array([[1.0, 0.0, by.shift_px[0]], [0.0, 1.0, by.shift_px[1]]])
    moved = cv2.warpAffine(light, move, (cols, rows), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(moved, np.float32)


def _blurred(light: Floats, width_px: float) -> Floats:
    import cv2

    return np.asarray(cv2.GaussianBlur(light, (0, 0), width_px), np.float32)


class _Film:
    """What a camera and its files make of light: noise, 8 bits, fewer pixels, compression."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._noise = math.exp(rng.uniform(math.log(0.4), math.log(3.0)))
        self._coarse = float(rng.uniform(0.3, 0.9)) if rng.random() < 0.12 else 1.0
        if self._coarse < 1.0 and rng.random() < 0.6:
            self._noise = float(rng.uniform(2.0, 6.0))  # as the dithered panels of an animation
        self._quality = int(rng.integers(40, 97)) if rng.random() < 0.12 else 0

    def expose(self, rng: np.random.Generator, light: Floats, noise: float) -> Image:
        import cv2

        rows, cols = light.shape[:2]
        seen = light
        if self._coarse < 1.0:
            seen = cv2.resize(light, None, fx=self._coarse, fy=self._coarse, interpolation=cv2.INTER_AREA)
        first = int(rng.integers(_WHITE - seen.size))
        grain = _white()[first : first + seen.size].reshape(seen.shape)
        grey = np.clip(np.rint(seen + grain * np.float32(self._noise * noise)), 0, 255).astype(np.uint8)
        if self._coarse < 1.0:
            grey = np.asarray(cv2.resize(grey, (cols, rows), interpolation=cv2.INTER_LINEAR), np.uint8)
        return freeze(_compressed(grey, self._quality) if self._quality else grey)


def _compressed(picture: Image, quality: int) -> Image:
    """Through a JPEG file."""
    import cv2

    _, file = cv2.imencode(".jpg", picture[..., ::-1], (cv2.IMWRITE_JPEG_QUALITY, quality))
    back = cv2.imdecode(file, cv2.IMREAD_COLOR)
    assert back is not None
    return np.ascontiguousarray(back[..., ::-1], np.uint8)
