"""What the network that reads gels looks at: 14 fields of 120 x 160, free of any unit of length.

    0-2    change of colour, in 40 grey levels
    3-5    the same as a ratio of brightness: twice the difference of logarithms
    6-8    the untouched picture, from -1 (black) to 1
    9, 10  slopes that the described lights would make of the change (least squares, linear): right and down
    11     the surface that these slopes integrate to, in 8 pixels
    12, 13 place in the picture, from -1 to 1

Slopes are lengths over lengths and the surface is told in pixels, so that a sensor's size does not enter at all: what
comes out in pixels becomes mm by the width of one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Floats, freeze
from pipeline.geometry.camera import Camera
from pipeline.physics import optics
from pipeline.sensors.spec import SensorSpec
from pipeline.simulation.gel_units import mirrored

ROWS, COLS, FIELDS = 120, 160, 14
_CHANGE_GREY = 40.0
_DARK_GREY = 8.0  # added to both pictures, so that camera noise in the dark has no large logarithm
_HINT_PX = 8.0
_SECANT = 0.2  # mm/mm: slopes at which the light's rates are taken
_PULL = 600.0  # grey levels squared per unit slope squared: what no lamp tells stays level
_STEEPEST = 1.5
_TURNS = 4  # of the slopes by the described light, the first of them linear


@dataclass(frozen=True, slots=True, kw_only=True)
class Frame:
    """How a sensor's picture lies in the fields: as it is or mirrored at its diagonal, filled up to 4 : 3, resized."""

    shape: tuple[int, int]  # of the sensor's picture
    mirrored: bool  # a portrait picture is: the fields are landscape

    @property
    def whole(self) -> tuple[int, int]:
        """Size (rows, cols), in the sensor's pixels, that is brought to 120 x 160; the picture is its upper left."""
        rows, cols = self.shape[::-1] if self.mirrored else self.shape
        return max(rows, math.ceil(cols * ROWS / COLS)), max(cols, math.ceil(rows * COLS / ROWS))

    @property
    def pixels(self) -> float:
        """Pixels of the sensor to one of the fields."""
        return self.whole[1] / COLS

    def small(self, picture: NDArray[Any]) -> Floats:
        """A picture (rows, cols, 3) of the sensor as the fields have it, (120, 160, 3) of 0 to 255."""
        import cv2

        turned = picture.transpose(1, 0, 2) if self.mirrored else picture
        rows, cols = turned.shape[:2]
        below, beside = self.whole[0] - rows, self.whole[1] - cols
        if below or beside:
            turned = cv2.copyMakeBorder(np.ascontiguousarray(turned), 0, below, 0, beside, cv2.BORDER_REPLICATE)
        way = cv2.INTER_AREA if self.pixels > 1.0 else cv2.INTER_LINEAR
        return np.asarray(cv2.resize(np.ascontiguousarray(turned), (COLS, ROWS), interpolation=way), np.float32)

    def large(self, field: Floats) -> Floats:
        """A field (120, 160) on the sensor's own pixels (rows, cols)."""
        import cv2

        rows, cols = self.whole
        grown = np.asarray(cv2.resize(field, (cols, rows), interpolation=cv2.INTER_CUBIC), np.float32)
        rows, cols = self.shape[::-1] if self.mirrored else self.shape
        part = grown[:rows, :cols]
        return np.ascontiguousarray(part.T if self.mirrored else part)


def frame(shape: tuple[int, int]) -> Frame:
    """Where the pictures (rows, cols) of a sensor go."""
    return Frame(shape=shape, mirrored=shape[0] > shape[1])


@dataclass(frozen=True, slots=True, kw_only=True)
class Light:
    """A described light on the fields."""

    sensor: SensorSpec  # (120, 160)
    inverse: Floats  # `inverse_light` of it


def light(sensor: SensorSpec) -> Light:
    """The light of a sensor that takes pictures of 120 x 160."""
    return Light(sensor=sensor, inverse=inverse_light(sensor))


def light_of(sensor: SensorSpec) -> Light:
    """The described light of any sensor."""
    rows, cols = sensor.camera.shape
    at, z_mm = frame((rows, cols)), float(np.median(sensor.rest_depth_mm))
    focal = z_mm / (sensor.pixel_mm * at.pixels)
    camera = Camera(rows=ROWS, cols=COLS, fx_px=focal, fy_px=focal, cx_px=0.5 * (COLS - 1), cy_px=0.5 * (ROWS - 1))
    described = optics.optics_of(sensor)
    lit = mirrored(described) if at.mirrored else described
    rest = freeze(np.full((ROWS, COLS), z_mm))
    return light(replace(sensor, camera=camera, rest_depth_mm=rest, optics=lit, markers=None))


def inverse_light(sensor: SensorSpec) -> Floats:
    """What makes slopes (right, down) of a change of colour by the described lights: (2, 3, rows, cols) per grey level.

    Least squares of a light that is linear in the slopes, pulled toward level.
    """
    level = np.zeros(sensor.camera.shape, np.float32)
    slope = np.full(sensor.camera.shape, _SECANT, np.float32)
    by_x = optics.colour_change(sensor, slope, level) - optics.colour_change(sensor, -slope, level)
    by_y = optics.colour_change(sensor, level, slope) - optics.colour_change(sensor, level, -slope)
    x, y = (np.ascontiguousarray(by.transpose(2, 0, 1)) / np.float32(2.0 * _SECANT) for by in (by_x, by_y))
    xx, yy, xy = (_summed(a, b) for a, b in ((x, x), (y, y), (x, y)))
    xx, yy = xx + np.float32(_PULL), yy + np.float32(_PULL)
    per = 1.0 / (xx * yy - xy * xy)
    return freeze(np.stack([(yy * x - xy * y) * per, (xx * y - xy * x) * per]).astype(np.float32))


def fields(touched: Floats, untouched: Floats, light: Light | None) -> Floats:
    """The fields (14, 120, 160) of two pictures (120, 160, 3) of 0 to 255.

    `light`: `light_of` the sensor, None = nobody has described it.
    """
    out = np.zeros((FIELDS, ROWS, COLS), np.float32)
    now, before = (np.ascontiguousarray(picture.transpose(2, 0, 1)) for picture in (touched, untouched))
    change = now - before
    out[0:3] = change * np.float32(1.0 / _CHANGE_GREY)
    out[3:6] = 2.0 * np.log((now + np.float32(_DARK_GREY)) / (before + np.float32(_DARK_GREY)))
    out[6:9] = before * np.float32(1.0 / 127.5) - np.float32(1.0)
    if light is not None:
        out[9:11] = _slopes(change, light)
        surface = _surface(out[9], out[10])
        out[11] = (surface - np.median(surface[::4, ::4])) / np.float32(_HINT_PX)
    out[12] = np.linspace(-1.0, 1.0, COLS, dtype=np.float32)[None, :]
    out[13] = np.linspace(-1.0, 1.0, ROWS, dtype=np.float32)[:, None]
    return out


def _slopes(change: Floats, light: Light) -> Floats:
    """Slopes (2, rows, cols) whose colour is nearest to the change: light falls off where they are steep."""
    found = np.zeros((2, ROWS, COLS), np.float32)
    rest = change
    for turn in range(_TURNS):
        if turn:
            seen = optics.colour_change(light.sensor, np.ascontiguousarray(found[0]), np.ascontiguousarray(found[1]))
            rest = change - seen.transpose(2, 0, 1)
        found = np.clip(found + [_summed(by, rest) for by in light.inverse], -_STEEPEST, _STEEPEST).astype(np.float32)
    return found


def _summed(a: Floats, b: Floats) -> Floats:
    """The sum over three colours of a product (3, rows, cols)."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _surface(gx: Floats, gy: Floats) -> Floats:
    """What `poisson.integrate` gives with a free border and pixels of length 1, for this one size: by two tables."""
    down, across, weight = _tables()
    div = np.zeros_like(gx)
    edges = 0.5 * (gx[:, 1:] + gx[:, :-1])
    div[:, 1:] += edges
    div[:, :-1] -= edges
    edges = 0.5 * (gy[1:] + gy[:-1])
    div[1:] += edges
    div[:-1] -= edges
    return np.asarray(down.T @ ((down @ div @ across.T) * weight) @ across, np.float32)


@lru_cache(maxsize=1)
def _tables() -> tuple[Floats, Floats, Floats]:
    """Cosine transforms of the columns (120, 120) and the rows (160, 160), and what each wave is multiplied with."""
    from scipy import fft

    down, across = (np.asarray(fft.dct(np.eye(n), axis=0, norm="ortho"), np.float32) for n in (ROWS, COLS))
    ky, kx = (4.0 * np.sin(np.arange(n) * (0.5 * np.pi / n)) ** 2 for n in (ROWS, COLS))
    total = ky[:, None] + kx[None, :]
    weight = np.divide(1.0, total, out=np.zeros_like(total), where=total > 0)
    return freeze(down), freeze(across), freeze(weight.astype(np.float32))
