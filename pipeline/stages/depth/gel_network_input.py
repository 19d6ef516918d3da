"""What the network that corrects physics looks at: 16 fields of 120 x 160, free of any unit of length or brightness.

    0-2    change of colour, each colour in its own largest of the touch
    3-5    the untouched picture, each colour against its own mean
    6, 7   slopes that the described lights would make of the change (linear and three turns on), in their own largest
    8, 9   slopes of the physical answer, in its depth to 8 pixels: right and down, as the two before
    10, 11 its indentation in its own depth, and where it is in contact, from 0 to 1
    12     its pressure, in its own largest
    13     logarithm of its depth in pixels: how steep it is
    14, 15 place in the picture, from -1 to 1

A touch and one twice as deep, seen by lamps half as bright, look alike but for the light's own curvature, and so they
do here. The untouched picture is the one that physics compares with, drift taken out. Only a box is looked at, the
contact and what is around it (`box`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Floats, Image, Mask, freeze
from pipeline.base.ranks import percentile
from pipeline.geometry.camera import Camera
from pipeline.physics import optics
from pipeline.physics.slopes import compute_slopes
from pipeline.sensors.parts import Glow, Optics
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth import contact

ROWS, COLS, N_CHANNELS = 120, 160, 16
FULL_BOX = (slice(0, ROWS), slice(0, COLS))
SLOPE_CHANNELS = (6, 8), (7, 9)  # to the right, down
SURFACE_CHANNEL, CONTACT_CHANNEL, PRESSURE_CHANNEL, LOG_DEPTH_CHANNEL, POSITION_CHANNEL = 10, 11, 12, 13, 14
SLOPE_SCALE_PX = 8.0
_LARGEST = 95  # percentile of the values: what is the largest but for a few
_LEAST_GREY, _LEAST_SLOPE, _LEAST_PX = 5.0, 0.02, 0.1  # what is less is noise, and stays small
_STEEP_PX = 4.0
_BLUR_PX = 0.7  # of the pressure
_AROUND, _GRID = 24, 16  # pixels of the fields around a contact that are looked at: a gel's thickness; whole steps
_SECANT = 0.2  # mm/mm: slopes at which the light's rates are taken
_PULL = 600.0  # grey levels squared per unit slope squared: what no lamp tells stays level
_STEEPEST = 1.5
_TURNS = 4  # of the slopes by the described light, the first of them linear


@dataclass(frozen=True, slots=True, kw_only=True)
class InputGrid:
    """How a sensor's picture lies in the fields: as it is or mirrored at its diagonal, filled up to 4 : 3, resized."""

    image_shape: tuple[int, int]  # of the sensor's picture
    is_transposed: bool  # a portrait picture is: the fields are landscape

    @property
    def padded_shape(self) -> tuple[int, int]:
        """Size (rows, cols), in the sensor's pixels, that is brought to 120 x 160; the picture is its upper left."""
        rows, cols = self.image_shape[::-1] if self.is_transposed else self.image_shape
        return max(rows, math.ceil(cols * ROWS / COLS)), max(cols, math.ceil(rows * COLS / ROWS))

    @property
    def pixels_per_cell(self) -> float:
        """Pixels of the sensor to one of the fields."""
        return self.padded_shape[1] / COLS

    def resample_to_grid(self, picture: NDArray[Any]) -> Floats:
        """A picture (rows, cols, 3) or a field (rows, cols) of the sensor on 120 x 160."""
        import cv2

        turned = np.asarray(picture.swapaxes(0, 1) if self.is_transposed else picture, np.float32)
        rows, cols = turned.shape[:2]
        below, beside = self.padded_shape[0] - rows, self.padded_shape[1] - cols
        if below or beside:
            turned = cv2.copyMakeBorder(np.ascontiguousarray(turned), 0, below, 0, beside, cv2.BORDER_REPLICATE)
        way = cv2.INTER_AREA if self.pixels_per_cell > 1.0 else cv2.INTER_LINEAR
        return np.asarray(cv2.resize(np.ascontiguousarray(turned), (COLS, ROWS), interpolation=way), np.float32)

    def resample_to_image(self, field: Floats) -> Floats:
        """A field (120, 160) on the sensor's own pixels (rows, cols)."""
        import cv2

        rows, cols = self.padded_shape
        grown = np.asarray(cv2.resize(field, (cols, rows), interpolation=cv2.INTER_CUBIC), np.float32)
        rows, cols = self.image_shape[::-1] if self.is_transposed else self.image_shape
        part = grown[:rows, :cols]
        return np.ascontiguousarray(part.T if self.is_transposed else part)


def make_grid(shape: tuple[int, int]) -> InputGrid:
    """Where the pictures (rows, cols) of a sensor go."""
    return InputGrid(image_shape=shape, is_transposed=shape[0] > shape[1])


@dataclass(frozen=True, slots=True, kw_only=True)
class DescribedLight:
    """A described light on the fields."""

    sensor: SensorSpec  # (120, 160)
    inverse: Floats  # `inverse_light` of it


def describe_light(sensor: SensorSpec) -> DescribedLight:
    """The described light of any sensor."""
    rows, cols = sensor.camera.shape
    at, z_mm = make_grid((rows, cols)), float(np.median(sensor.rest_depth_mm))
    focal = z_mm / (sensor.pixel_mm * at.pixels_per_cell)
    camera = Camera(rows=ROWS, cols=COLS, fx_px=focal, fy_px=focal, cx_px=0.5 * (COLS - 1), cy_px=0.5 * (ROWS - 1))
    described = optics.require_optics(sensor)
    lit = _swap_axes(described) if at.is_transposed else described
    rest = freeze(np.full((ROWS, COLS), z_mm))
    small = replace(sensor, camera=camera, rest_depth_mm=rest, optics=lit, markers=None)
    return DescribedLight(sensor=small, inverse=compute_inverse_light(small))


def _swap_axes(optics: Optics) -> Optics:
    """The same light with x and y exchanged."""
    leds = tuple(replace(led, azimuth_deg=(90.0 - led.azimuth_deg) % 360.0) for led in optics.leds)
    glows = tuple(Glow(x=g.y, y=g.x, width=g.height, height=g.width, rgb=g.rgb) for g in optics.glows)
    return replace(optics, leds=leds, glows=glows)


def compute_inverse_light(sensor: SensorSpec) -> Floats:
    """What makes slopes (right, down) of a change of colour by the described lights: (2, 3, rows, cols) per grey level.

    Least squares of a light that is linear in the slopes, pulled toward level.
    """
    level = np.zeros(sensor.camera.shape, np.float32)
    slope = np.full(sensor.camera.shape, _SECANT, np.float32)
    by_x = optics.compute_colour_change(sensor, slope, level) - optics.compute_colour_change(sensor, -slope, level)
    by_y = optics.compute_colour_change(sensor, level, slope) - optics.compute_colour_change(sensor, level, -slope)
    x, y = (np.ascontiguousarray(by.transpose(2, 0, 1)) / np.float32(2.0 * _SECANT) for by in (by_x, by_y))
    xx, yy, xy = (_sum_colours(a, b) for a, b in ((x, x), (y, y), (x, y)))
    xx, yy = xx + np.float32(_PULL), yy + np.float32(_PULL)
    per = 1.0 / (xx * yy - xy * xy)
    return freeze(np.stack([(yy * x - xy * y) * per, (xx * y - xy * x) * per]).astype(np.float32))


@dataclass(frozen=True, slots=True, kw_only=True)
class NetworkInput:
    """A frame and its physical answer on 120 x 160 pixels: what the fields are made of."""

    image: Floats  # (120, 160, 3) of 0 to 255
    reference: Floats  # the same, in the light and at the place of `touched`
    slopes: Floats  # (2, 120, 160) that the described lights would make of the change: right and down
    physical_px: Floats  # (120, 160) indentation
    physical_contact: Floats  # (120, 160) share in contact


def prepare_input(
    image: Image, still: Floats, physical_mm: Floats, touched: Mask, source: SensorSpec, light: DescribedLight
) -> NetworkInput:
    """A sensor's picture and its physical answer, each (rows, cols, ...) of the sensor; `light`: `light_of` it."""
    at = make_grid(source.camera.shape)
    shown, untouched = at.resample_to_grid(image), at.resample_to_grid(still)
    return NetworkInput(
        image=shown, reference=untouched, slopes=_slopes(_split_colours(shown - untouched), light),
        physical_px=at.resample_to_grid(physical_mm) / np.float32(source.pixel_mm * at.pixels_per_cell),
        physical_contact=at.resample_to_grid(touched.astype(np.float32)),
    )  # fmt: skip


def compute_depth_px(of: NetworkInput) -> float:
    """How deep the physical answer is in its contact, in pixels of the fields: what its surface is told in."""
    pressed = compute_contact_mask(of)
    return max(float(percentile(of.physical_px, _LARGEST, pressed)) if pressed.any() else 0.0, _LEAST_PX)


def compute_contact_box(of: NetworkInput) -> tuple[slice, slice]:
    """The contact and a gel's thickness around it: rows and columns of the fields."""
    pressed, found = compute_contact_mask(of), []
    for axis, most in ((1, ROWS), (0, COLS)):
        there = np.flatnonzero(pressed.any(axis=axis))
        first, last = (int(there[0]), int(there[-1]) + 1) if there.size else (0, most)
        first = max(0, first - _AROUND)
        length = min(most, -(-(min(most, last + _AROUND) - first) // _GRID) * _GRID)
        first = min(first, most - length)
        found.append(slice(first, first + length))
    return found[0], found[1]


def compute_peak_slope(of: NetworkInput, at: tuple[slice, slice] = FULL_BOX) -> float:
    """The largest slope in a box's contact that the described lights would make of the change, but for a few."""
    import cv2

    right, down = (np.ascontiguousarray(slope[at]) for slope in of.slopes)
    return max(
        _LEAST_SLOPE, compute_peak(np.asarray(cv2.magnitude(right, down), np.float32), compute_contact_mask(of)[at])
    )


def compute_channels(of: NetworkInput, at: tuple[slice, slice] = FULL_BOX, peak_slope: float | None = None) -> Floats:
    """The fields (16, rows, cols) of a box; `steep`: the box's `steepest`, if it is known."""
    pressed, deep = compute_contact_mask(of)[at], compute_depth_px(of)
    now, before = (
        _split_colours(of.image[at]),
        np.maximum(_split_colours(of.reference[at]), 0.0),
    )  # drift may take all light away
    out = np.zeros((N_CHANNELS, *now.shape[1:]), np.float32)
    out[0:3] = [_in_own(change, pressed, _LEAST_GREY) for change in now - before]
    mean = np.maximum(_split_colours(of.reference).mean(axis=(1, 2)), _LEAST_GREY)[:, None, None]
    out[3:6] = np.clip(before / mean - 1.0, -1.5, 1.5)
    peak_slope = compute_peak_slope(of, at) if peak_slope is None else peak_slope
    out[6:8] = np.clip(of.slopes[:, at[0], at[1]] / np.float32(peak_slope), -3.0, 3.0)
    surface = of.physical_px[at] / np.float32(deep)
    out[8], out[9] = (np.float32(SLOPE_SCALE_PX) * slope for slope in compute_slopes(surface, 1.0))
    out[SURFACE_CHANNEL] = surface
    out[CONTACT_CHANNEL] = of.physical_contact[at]
    out[PRESSURE_CHANNEL] = _in_own(contact.compute_relative_pressure(surface, _BLUR_PX), pressed, 1e-3)
    out[LOG_DEPTH_CHANNEL] = math.log(deep / _STEEP_PX)
    out[14] = np.linspace(-1.0, 1.0, COLS, dtype=np.float32)[None, at[1]]
    out[15] = np.linspace(-1.0, 1.0, ROWS, dtype=np.float32)[at[0], None]
    return out


def compute_contact_mask(of: NetworkInput) -> Mask:
    """The physical contact; what of it is nearest to one where it is smaller than a pixel."""
    return np.asarray(of.physical_contact > min(0.5, 0.5 * float(of.physical_contact.max())), np.bool_)


def _in_own(field: Floats, pressed: Mask, least: float) -> Floats:
    return np.clip(field / np.float32(max(least, compute_peak(np.abs(field), pressed))), -3.0, 3.0)


def compute_peak(field: Floats, pressed: Mask) -> float:
    """What is the largest of a field (rows, cols) in the contact, but for a few."""
    return float(percentile(field, _LARGEST, pressed)) if pressed.any() else float(field.max(initial=0.0))


def _split_colours(picture: Floats) -> Floats:
    return np.ascontiguousarray(picture.transpose(2, 0, 1))


def _slopes(change: Floats, light: DescribedLight) -> Floats:
    """Slopes (2, rows, cols) whose colour is nearest to the change: light falls off where they are steep."""
    found = np.zeros((2, ROWS, COLS), np.float32)
    rest = change
    for turn in range(_TURNS):
        if turn:
            seen = optics.compute_colour_change(
                light.sensor, np.ascontiguousarray(found[0]), np.ascontiguousarray(found[1])
            )
            rest = change - seen.transpose(2, 0, 1)
        found = np.clip(found + [_sum_colours(by, rest) for by in light.inverse], -_STEEPEST, _STEEPEST).astype(
            np.float32
        )
    return found


def _sum_colours(a: Floats, b: Floats) -> Floats:
    """The sum over three colours of a product (3, rows, cols)."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
