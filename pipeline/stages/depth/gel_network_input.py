"""Input of the network that corrects the photometric depth of gels: 16 channels of 120 x 160, without units.

    0-2    change of colour, each colour in units of its largest value in contact
    3-5    reference image, each colour relative to its own mean
    6, 7   slopes (right, down) that explain the change under the described light, in units of the largest
    8, 9   slopes (right, down) of the physical surface, in its depth per 8 pixels
    10, 11 physical indentation in units of its depth; share in contact, 0 to 1
    12     physical pressure in units of its largest value
    13     log of the physical depth in pixels: how steep the touch is
    14, 15 position in the image, -1 to 1

A touch twice as deep under LEDs half as bright looks the same except for saturation and the nonlinearity of the
shading, and so it does in these channels. The reference is the one that physics compares with, drift removed.
"""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Floats, Image, Mask, freeze, percentile
from pipeline.geometry.camera import Camera
from pipeline.physics import optics
from pipeline.physics.slopes import compute_slopes
from pipeline.sensors.parts import Glow, Optics
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth import bubble_contact

ROWS, COLS, N_CHANNELS = 120, 160, 16
SLOPE_CHANNELS = (6, 8), (7, 9)  # right, down
SURFACE_CHANNEL, CONTACT_CHANNEL, PRESSURE_CHANNEL, LOG_DEPTH_CHANNEL, POSITION_CHANNEL = 10, 11, 12, 13, 14
SLOPE_SCALE_PX = 8.0
_LARGEST_PERCENT = 95  # percentile that counts as the largest value, so that a few outliers do not
_CHANGE_MIN_GREY, _SLOPE_MIN, _DEPTH_MIN_PX, _PRESSURE_MIN = 5.0, 0.02, 0.1, 1e-3  # smaller units would amplify noise
_CHANNEL_LIMIT, _REFERENCE_LIMIT = 3.0, 1.5
_DEPTH_UNIT_PX = 4.0
_PRESSURE_BLUR_PX = 0.7
_SLOPE_STEP = 0.2  # mm/mm: slopes at which the derivative of the shading is taken
_SLOPE_PRIOR = 600.0  # grey levels squared per unit slope squared: directions that no LED shows stay level
_SLOPE_MAX = 1.5
_SLOPE_ITERATIONS = 4  # the first is linear


@dataclass(frozen=True, slots=True, kw_only=True)
class InputGrid:
    """How a sensor's image is mapped to 120 x 160: transposed if portrait, padded to 4 : 3, resized."""

    image_shape: tuple[int, int]  # of the sensor's image
    is_transposed: bool  # portrait

    @property
    def padded_shape(self) -> tuple[int, int]:
        """(rows, cols) in the sensor's pixels that is resized to 120 x 160; the image is its upper left."""
        rows, cols = self.image_shape[::-1] if self.is_transposed else self.image_shape
        return max(rows, math.ceil(cols * ROWS / COLS)), max(cols, math.ceil(rows * COLS / ROWS))

    @property
    def pixels_per_cell(self) -> float:
        """Pixels of the sensor along one pixel of the grid."""
        return self.padded_shape[1] / COLS

    def resample_to_grid(self, image: NDArray[Any]) -> Floats:
        """An image (rows, cols, 3) or a field (rows, cols) of the sensor, on 120 x 160."""
        import cv2

        landscape = np.asarray(image.swapaxes(0, 1) if self.is_transposed else image, np.float32)
        rows, cols = landscape.shape[:2]
        bottom, right = self.padded_shape[0] - rows, self.padded_shape[1] - cols
        if bottom or right:
            landscape = cv2.copyMakeBorder(np.ascontiguousarray(landscape), 0, bottom, 0, right, cv2.BORDER_REPLICATE)
        kind = cv2.INTER_AREA if self.pixels_per_cell > 1.0 else cv2.INTER_LINEAR
        return np.asarray(cv2.resize(np.ascontiguousarray(landscape), (COLS, ROWS), interpolation=kind), np.float32)

    def resample_to_image(self, field: Floats) -> Floats:
        """A field (120, 160) on the sensor's own pixels (rows, cols)."""
        import cv2

        rows, cols = self.padded_shape
        padded = np.asarray(cv2.resize(field, (cols, rows), interpolation=cv2.INTER_CUBIC), np.float32)
        rows, cols = self.image_shape[::-1] if self.is_transposed else self.image_shape
        part = padded[:rows, :cols]
        return np.ascontiguousarray(part.T if self.is_transposed else part)


def make_grid(shape: tuple[int, int]) -> InputGrid:
    """The grid of images (rows, cols) of a sensor."""
    return InputGrid(image_shape=shape, is_transposed=shape[0] > shape[1])


@dataclass(frozen=True, slots=True, kw_only=True)
class DescribedLight:
    """The light of a sensor's description on the grid."""

    sensor: SensorSpec  # with a camera of 120 x 160
    inverse: Floats  # (2, 3, 120, 160) `compute_inverse_light` of it


def describe_light(sensor: SensorSpec) -> DescribedLight:
    """The light of a sensor's description on its grid."""
    rows, cols = sensor.camera.shape
    grid, z_mm = make_grid((rows, cols)), float(np.median(sensor.rest_depth_mm))
    focal = z_mm / (sensor.pixel_mm * grid.pixels_per_cell)
    camera = Camera(rows=ROWS, cols=COLS, fx_px=focal, fy_px=focal, cx_px=0.5 * (COLS - 1), cy_px=0.5 * (ROWS - 1))
    described = optics.require_optics(sensor)
    light = _swap_axes(described) if grid.is_transposed else described
    rest = freeze(np.full((ROWS, COLS), z_mm))
    small = replace(sensor, camera=camera, rest_depth_mm=rest, optics=light, markers=None)
    return DescribedLight(sensor=small, inverse=compute_inverse_light(small))


def _swap_axes(optics: Optics) -> Optics:
    """The same light with x and y exchanged."""
    leds = tuple(replace(led, azimuth_deg=(90.0 - led.azimuth_deg) % 360.0) for led in optics.leds)
    glows = tuple(Glow(x=g.y, y=g.x, width=g.height, height=g.width, rgb=g.rgb) for g in optics.glows)
    return replace(optics, leds=leds, glows=glows)


def compute_inverse_light(sensor: SensorSpec) -> Floats:
    """Slopes (right, down) per grey level of colour change under the described light, (2, 3, rows, cols).

    Least squares of a shading linear in the slopes, with a prior toward level.
    """
    level = np.zeros(sensor.camera.shape, np.float32)
    slope = np.full(sensor.camera.shape, _SLOPE_STEP, np.float32)
    by_x = optics.compute_colour_change(sensor, slope, level) - optics.compute_colour_change(sensor, -slope, level)
    by_y = optics.compute_colour_change(sensor, level, slope) - optics.compute_colour_change(sensor, level, -slope)
    x, y = (np.ascontiguousarray(by.transpose(2, 0, 1)) / np.float32(2.0 * _SLOPE_STEP) for by in (by_x, by_y))
    xx, yy, xy = (_sum_colours(a, b) for a, b in ((x, x), (y, y), (x, y)))
    xx, yy = xx + np.float32(_SLOPE_PRIOR), yy + np.float32(_SLOPE_PRIOR)
    per = 1.0 / (xx * yy - xy * xy)
    return freeze(np.stack([(yy * x - xy * y) * per, (xx * y - xy * x) * per]).astype(np.float32))


@dataclass(frozen=True, slots=True, kw_only=True)
class NetworkInput:
    """A frame and its photometric depth on 120 x 160 pixels, from which the channels are computed."""

    image: Floats  # (120, 160, 3), 0 to 255
    reference: Floats  # the same of the reference, with the image's drift applied
    slopes: Floats  # (2, 120, 160) right and down, that explain the change under the described light
    physical_px: Floats  # (120, 160) indentation in pixels of the grid
    physical_contact: Floats  # (120, 160) share in contact


def prepare_input(
    image: Image, reference: Floats, physical_mm: Floats, touched: Mask, source: SensorSpec, light: DescribedLight
) -> NetworkInput:
    """The input from an image, its reference, photometric depth and contact, each (rows, cols, ...) of the sensor."""
    grid = make_grid(source.camera.shape)
    small, small_reference = grid.resample_to_grid(image), grid.resample_to_grid(reference)
    return NetworkInput(
        image=small, reference=small_reference, slopes=_estimate_slopes(_split_colours(small - small_reference), light),
        physical_px=grid.resample_to_grid(physical_mm) / np.float32(source.pixel_mm * grid.pixels_per_cell),
        physical_contact=grid.resample_to_grid(touched.astype(np.float32)),
    )  # fmt: skip


def compute_depth_px(inputs: NetworkInput) -> float:
    """Depth of the physical contact in pixels of the grid: the unit of the network's lengths."""
    touched = compute_contact_mask(inputs)
    largest = float(percentile(inputs.physical_px, _LARGEST_PERCENT, touched)) if touched.any() else 0.0
    return max(largest, _DEPTH_MIN_PX)


def compute_peak_slope(inputs: NetworkInput) -> float:
    """The largest slope in contact under the described light."""
    import cv2

    right, down = (np.ascontiguousarray(slope) for slope in inputs.slopes)
    magnitude = np.asarray(cv2.magnitude(right, down), np.float32)
    return max(_SLOPE_MIN, _compute_peak(magnitude, compute_contact_mask(inputs)))


def compute_channels(inputs: NetworkInput, peak_slope: float | None = None) -> Floats:
    """The channels (16, 120, 160); `peak_slope`: `compute_peak_slope`, if it is known already."""
    touched, depth_px = compute_contact_mask(inputs), compute_depth_px(inputs)
    image = _split_colours(inputs.image)
    reference = np.maximum(_split_colours(inputs.reference), 0.0)  # drift may make it negative
    out = np.zeros((N_CHANNELS, ROWS, COLS), np.float32)
    out[0:3] = [_normalise(change, touched, _CHANGE_MIN_GREY) for change in image - reference]
    mean = _split_colours(inputs.reference).mean(axis=(1, 2))
    mean = np.maximum(mean, _CHANGE_MIN_GREY)[:, None, None]
    out[3:6] = np.clip(reference / mean - 1.0, -_REFERENCE_LIMIT, _REFERENCE_LIMIT)
    peak_slope = compute_peak_slope(inputs) if peak_slope is None else peak_slope
    out[6:8] = np.clip(inputs.slopes / np.float32(peak_slope), -_CHANNEL_LIMIT, _CHANNEL_LIMIT)
    surface = inputs.physical_px / np.float32(depth_px)
    out[8], out[9] = (np.float32(SLOPE_SCALE_PX) * slope for slope in compute_slopes(surface, 1.0))
    out[SURFACE_CHANNEL] = surface
    out[CONTACT_CHANNEL] = inputs.physical_contact
    out[PRESSURE_CHANNEL] = _normalise(
        bubble_contact.compute_relative_pressure(surface, _PRESSURE_BLUR_PX), touched, _PRESSURE_MIN
    )
    out[LOG_DEPTH_CHANNEL] = math.log(depth_px / _DEPTH_UNIT_PX)
    out[POSITION_CHANNEL] = np.linspace(-1.0, 1.0, COLS, dtype=np.float32)
    out[POSITION_CHANNEL + 1] = np.linspace(-1.0, 1.0, ROWS, dtype=np.float32)[:, None]
    return out


def compute_contact_mask(inputs: NetworkInput) -> Mask:
    """The physical contact (120, 160); where it is smaller than one pixel, the pixels with the largest share."""
    share = inputs.physical_contact
    return np.asarray(share > min(0.5, 0.5 * float(share.max())), np.bool_)


def _normalise(field: Floats, touched: Mask, least: float) -> Floats:
    """A field in units of its largest magnitude in contact, at least `least`."""
    unit = np.float32(max(least, _compute_peak(np.abs(field), touched)))
    return np.clip(field / unit, -_CHANNEL_LIMIT, _CHANNEL_LIMIT)


def _compute_peak(field: Floats, touched: Mask) -> float:
    """The largest value of a field (rows, cols) in contact, except for a few outliers."""
    return float(percentile(field, _LARGEST_PERCENT, touched)) if touched.any() else float(field.max(initial=0.0))


def _split_colours(image: Floats) -> Floats:
    """Channels first: (3, rows, cols)."""
    return np.ascontiguousarray(image.transpose(2, 0, 1))


def _estimate_slopes(change: Floats, light: DescribedLight) -> Floats:
    """Slopes (2, rows, cols) whose shading is nearest to a change (3, rows, cols), by Gauss-Newton iterations."""
    slopes = np.zeros((2, ROWS, COLS), np.float32)
    residual = change
    for iteration in range(_SLOPE_ITERATIONS):
        if iteration:
            residual = change - _render_described_change(light.sensor, *slopes)
        step = [_sum_colours(by, residual) for by in light.inverse]
        slopes = np.clip(slopes + step, -_SLOPE_MAX, _SLOPE_MAX).astype(np.float32)
    return slopes


def _sum_colours(a: Floats, b: Floats) -> Floats:
    """The sum over three colours of a product (3, rows, cols)."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _render_described_change(sensor: SensorSpec, right: Floats, down: Floats) -> Floats:
    """`optics.compute_colour_change` of slopes (rows, cols), compiled and channels first."""
    from pipeline.stages.depth.illumination.illumination_kernels import N_LINES, TILE_PX, render_led_light

    described, (rows, cols) = optics.require_optics(sensor), right.shape
    x, y, size = (
        np.arange(cols, dtype=np.float32),
        np.arange(rows, dtype=np.float32),
        np.array([cols, rows], np.float32),
    )
    place = (x, y, size, *optics.pack_leds(described, sensor.camera), np.float32(described.vignette))
    one, scratch = np.ones((rows, cols, 3), np.float32), np.empty(N_LINES * TILE_PX, np.float32)
    change, *rates = (np.empty_like(one) for _ in range(3))
    render_led_light(right, down, place, (one, one, one), scratch, change, *rates)
    return _split_colours(change)
