"""What the network that corrects physics looks at: 17 fields of 120 x 160, free of any unit of length.

    0-2    change of colour, in 40 grey levels
    3-5    the same as a ratio of brightness: twice the difference of logarithms
    6-8    the untouched picture, from -1 (black) to 1
    9, 10  slopes that the described lights would make of the change (least squares, linear): right and down
    11, 12 slopes of the physical answer
    13, 14 its indentation in 8 pixels, and where it is in contact, from 0 to 1
    15, 16 place in the picture, from -1 to 1

The untouched picture is the one that physics compares with, drift taken out. Slopes are lengths over lengths and the
surface is told in pixels, so that a sensor's size does not enter at all: what comes out in pixels becomes mm by the
width of one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Floats, Image, Mask, freeze
from pipeline.geometry.camera import Camera
from pipeline.physics import optics
from pipeline.physics.slopes import slopes
from pipeline.sensors.parts import Glow, Optics
from pipeline.sensors.spec import SensorSpec

ROWS, COLS, FIELDS = 120, 160, 17
SLOPE_FIELDS = (9, 11), (10, 12)  # to the right, down
SURFACE, PRESSED, PLACE = 13, 14, 15
SURFACE_PX = 8.0
_CHANGE_GREY = 40.0
_DARK_GREY = 8.0  # added to both pictures, so that camera noise in the dark has no large logarithm
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
        """A picture (rows, cols, 3) or a field (rows, cols) of the sensor on 120 x 160."""
        import cv2

        turned = np.asarray(picture.swapaxes(0, 1) if self.mirrored else picture, np.float32)
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


def light_of(sensor: SensorSpec) -> Light:
    """The described light of any sensor."""
    rows, cols = sensor.camera.shape
    at, z_mm = frame((rows, cols)), float(np.median(sensor.rest_depth_mm))
    focal = z_mm / (sensor.pixel_mm * at.pixels)
    camera = Camera(rows=ROWS, cols=COLS, fx_px=focal, fy_px=focal, cx_px=0.5 * (COLS - 1), cy_px=0.5 * (ROWS - 1))
    described = optics.optics_of(sensor)
    lit = _mirrored(described) if at.mirrored else described
    rest = freeze(np.full((ROWS, COLS), z_mm))
    small = replace(sensor, camera=camera, rest_depth_mm=rest, optics=lit, markers=None)
    return Light(sensor=small, inverse=inverse_light(small))


def _mirrored(optics: Optics) -> Optics:
    """The same light with x and y exchanged."""
    leds = tuple(replace(led, azimuth_deg=(90.0 - led.azimuth_deg) % 360.0) for led in optics.leds)
    glows = tuple(Glow(x=g.y, y=g.x, width=g.height, height=g.width, rgb=g.rgb) for g in optics.glows)
    return replace(optics, leds=leds, glows=glows)


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


@dataclass(frozen=True, slots=True, kw_only=True)
class Seen:
    """A frame and its physical answer on 120 x 160 pixels: what the fields are made of."""

    touched: Floats  # (120, 160, 3) of 0 to 255
    untouched: Floats  # the same, in the light and at the place of `touched`
    slopes: Floats  # (2, 120, 160) that the described lights would make of the change: right and down
    physical_px: Floats  # (120, 160) indentation
    pressed: Floats  # (120, 160) share in contact


def seen(image: Image, still: Floats, physical_mm: Floats, contact: Mask, source: SensorSpec, light: Light) -> Seen:
    """A sensor's picture and its physical answer, each (rows, cols, ...) of the sensor; `light`: `light_of` it."""
    at = frame(source.camera.shape)
    touched, untouched = at.small(image), at.small(still)
    return Seen(
        touched=touched, untouched=untouched, slopes=_slopes(_planes(touched - untouched), light),
        physical_px=at.small(physical_mm) / np.float32(source.pixel_mm * at.pixels),
        pressed=at.small(contact.astype(np.float32)),
    )  # fmt: skip


def fields(of: Seen) -> Floats:
    """The fields (17, 120, 160)."""
    out = np.zeros((FIELDS, ROWS, COLS), np.float32)
    now, before = _planes(of.touched), np.maximum(_planes(of.untouched), 0.0)  # where drift took all light away
    out[0:3] = (now - before) * np.float32(1.0 / _CHANGE_GREY)
    out[3:6] = 2.0 * np.log((now + np.float32(_DARK_GREY)) / (before + np.float32(_DARK_GREY)))
    out[6:9] = before * np.float32(1.0 / 127.5) - np.float32(1.0)
    out[9:11] = of.slopes
    out[11], out[12] = slopes(of.physical_px, 1.0)
    out[SURFACE] = of.physical_px * np.float32(1.0 / SURFACE_PX)
    out[PRESSED] = of.pressed
    out[15] = np.linspace(-1.0, 1.0, COLS, dtype=np.float32)[None, :]
    out[16] = np.linspace(-1.0, 1.0, ROWS, dtype=np.float32)[:, None]
    return out


def _planes(picture: Floats) -> Floats:
    return np.ascontiguousarray(picture.transpose(2, 0, 1))


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
