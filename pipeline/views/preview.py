"""Preview of a value: pixels with values, positions and outlines as plain arrays, headless.

Tile of a comparison: a preview with its text.
"""

import math
from collections.abc import Mapping
from dataclasses import field, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.core.arrays import Floats, Image, Indices, Mask, freeze
from pipeline.core.frozen import frozen
from pipeline.core.geometry.camera import Camera
from pipeline.core.values.frames import TactileFrame
from pipeline.core.values.results import DepthMap, TargetDepth
from pipeline.sensors.spec import SensorSpec
from pipeline.views.colours import ColourScale, apply_colour_map
from pipeline.views.display_params import DisplayParams

INDENTATION_LABEL = "indentation, + toward camera"
DEVIATION_LABEL = "deviation from rest, + toward camera"
_SHORTEST_PIECE = 6  # border pixels; a shorter outline would hide its own pixel


class PixelPositions(NamedTuple):
    """Positions of pixels along the rays of a camera, computed on demand: all of them cost half
    a preview.
    """

    camera: Camera
    depth_mm: Floats  # (rows, cols), NaN = no value

    def compute_all_mm(self) -> Floats:
        """Return the position (rows, cols, 3) of each pixel in the camera frame, NaN = none."""
        return freeze(self.camera.back_project(self.depth_mm).astype(np.float32))

    def compute_point_mm(self, row: int, col: int) -> tuple[float, float, float]:
        """Return the position of one pixel."""
        z = float(self.depth_mm[row, col])
        x, y = self.camera.rays()
        return float(x[col]) * z, float(y[row]) * z, z


@frozen
class Preview:
    """Pixels and their meaning."""

    pixels: Image  # (rows, cols, 3) uint8
    frame_name: str  # frame of `positions_mm`
    values: Floats | None = None  # (rows, cols) shown by the probe; None = the colour itself
    # (rows, cols) measured distance from the camera, where `values` follow from it
    distance_mm: Floats | None = None
    scale: ColourScale | None = None  # None = true colours
    # of each pixel; as an array (rows, cols, 3), NaN = none
    positions_mm: PixelPositions | Floats | None = None
    outline_px: Floats | None = None  # (n, 2) x, y of the contact outline, NaN between pieces
    observed_outline_px: Floats | None = None  # (n, 2) outline of another contact to compare with
    pixel_mm: float = math.nan  # width of a pixel on the surface
    caption: str = ""
    element_index: Indices | None = (
        None  # (rows, cols) index of the element on display, -1 = none; None = the pixel's own
    )
    camera: Camera | None = None  # camera of this image, where it is not one pixel per element

    def get_value(self, row: int, col: int) -> float | None:
        """Return the value of a pixel, NaN for none; None of a colour image and outside."""
        has_values = self.values is not None and self.scale is not None
        is_value = has_values and self._holds(row, col)
        return float(self.values[row, col]) if is_value and self.values is not None else None

    def format_value(self, row: int, col: int) -> str:
        """Return the value of a pixel with its unit, or its colour; "" outside the image."""
        if not self._holds(row, col):
            return ""
        value = self.get_value(row, col)
        if value is None or self.scale is None:
            return "rgb {} {} {}".format(*self.pixels[row, col].tolist())
        return f"{value:.3f} {self.scale.unit}" if math.isfinite(value) else "none"

    def describe_pixel(self, row: int, col: int) -> str:
        """Return (x, y) in pixels, value with unit, position with frame; "" outside the image."""
        if not self._holds(row, col):
            return ""
        value = self.format_value(row, col)
        if self.values is not None and self.scale is not None:
            quantity = self.scale.quantity.split(",")[0]
            value = f"{quantity}: none" if value == "none" else f"{quantity} {value}"
        parts = [f"({col}, {row})", value]
        distance_mm = math.nan if self.distance_mm is None else float(self.distance_mm[row, col])
        if math.isfinite(distance_mm):
            parts.append(f"distance {distance_mm:.2f} mm")
        places = self.positions_mm
        if places is not None:
            x, y, z = (
                places[row, col].tolist()
                if isinstance(places, np.ndarray)
                else places.compute_point_mm(row, col)
            )
            if math.isfinite(x + y + z):
                parts.append(f"x {x:.2f}, y {y:.2f}, z {z:.2f} mm in {self.frame_name}")
        return " · ".join(parts)

    def compute_positions_mm(self) -> Floats | None:
        """Return the position (rows, cols, 3) of each pixel, NaN = none.

        None where no position is known.
        """
        places = self.positions_mm
        return places.compute_all_mm() if isinstance(places, PixelPositions) else places

    def _holds(self, row: int, col: int) -> bool:
        rows, cols = self.pixels.shape[:2]
        return 0 <= row < rows and 0 <= col < cols


def make_indentation_preview(
    heights_mm: Floats,
    depth: DepthMap | TargetDepth,
    sensor: SensorSpec,
    display: DisplayParams,
    caption: str = INDENTATION_LABEL,
) -> Preview:
    """Return the preview of indentation (rows, cols) on its absolute scale, with the contact
    outline of the depth that it belongs to.
    """
    scale = make_indentation_scale(sensor, display)
    return Preview(
        pixels=apply_colour_map(heights_mm, scale),
        values=heights_mm,
        scale=scale,
        frame_name=f"{sensor.title} frame",
        positions_mm=PixelPositions(depth.camera, depth.depth_mm),
        outline_px=trace_outline(depth.contact),
        pixel_mm=compute_pixel_mm(depth.camera, sensor),
        caption=caption,
    )


def make_frame_preview(
    image: Image | Floats,
    camera: Camera,
    sensor: SensorSpec,
    display: DisplayParams,
    *,
    depth_mm: Floats | None = None,
    contact: Mask | None = None,
    reference: NDArray[np.generic] | None = None,
    is_recorded: bool = True,
) -> Preview:
    """A reading: true colours of a gel, how far a bubble's membrane is from its rest, or its
    distance if so displayed.

    `depth_mm` is where the membrane lies, if that is known in addition to a gel's image. The rest
    is the untouched `reference` of the very unit, where there is one, else the described shape,
    which a reading that was `recorded` need not have had.
    """
    place = f"{sensor.title} frame"
    make_preview = partial(
        Preview,
        frame_name=place,
        pixel_mm=compute_pixel_mm(camera, sensor),
        outline_px=None if contact is None else trace_outline(contact),
    )
    if image.ndim == 3:
        return make_preview(
            pixels=np.asarray(image, dtype=np.uint8),
            positions_mm=None if depth_mm is None else PixelPositions(camera, depth_mm),
            caption=f"rgb image, {camera.cols} x {camera.rows} px",
        )
    depth = np.asarray(image, dtype=np.float32)
    if display.bubble_quantity == "distance":
        values = depth
        scale = make_distance_scale(sensor, display, reference)
        caption = f"{scale.quantity}, {place}"
    else:
        rest, whose = _rest_of(sensor, camera, reference, depth.shape, recorded=is_recorded)
        values = freeze((rest - depth).astype(np.float32))
        scale = make_deviation_scale(sensor, display)
        caption = f"{scale.quantity}{whose}"
    return make_preview(
        pixels=apply_colour_map(values, scale),
        values=values,
        scale=scale,
        positions_mm=PixelPositions(camera, depth),
        caption=caption,
        distance_mm=None if values is depth else depth,
    )


def make_recorded_preview(
    frame: TactileFrame, sensor: SensorSpec, display: DisplayParams
) -> tuple[Preview, Camera]:
    """The preview of a recorded frame of a sensor, and the camera that took it."""
    camera = match_camera(frame.camera or sensor.camera, frame.image.shape)
    return make_frame_preview(
        frame.shown_image, camera, sensor, display, reference=frame.reference
    ), camera


def add_observed_outline(picture: Preview, observed_outline_px: Floats | None) -> Preview:
    """Return the preview with the outline of the contact that the target observed."""
    if observed_outline_px is None:
        return picture
    return replace(
        picture,
        observed_outline_px=observed_outline_px,
        caption=f"{INDENTATION_LABEL}; orange: mask, white: observed by the target",
    )


def enlarge_preview(picture: Preview, shape: tuple[int, int]) -> Preview:
    """Return a coarse preview on as many pixels as the full one has, so that the view stays."""
    import cv2

    rows, cols = shape
    old_rows, old_cols = picture.pixels.shape[:2]
    if (old_rows, old_cols) == shape:
        return picture

    def enlarge(values: Any) -> Any:
        enlarged = cv2.resize(values, (cols, rows), interpolation=cv2.INTER_NEAREST)
        return freeze(enlarged)

    times = np.array([cols / old_cols, rows / old_rows], dtype=np.float32)
    arrays = {
        "pixels": picture.pixels,
        "values": picture.values,
        "positions_mm": picture.compute_positions_mm(),
        "distance_mm": picture.distance_mm,
    }
    return replace(
        picture,
        pixel_mm=picture.pixel_mm / float(times[0]),
        outline_px=None if picture.outline_px is None else freeze(picture.outline_px * times),
        **{name: enlarge(array) for name, array in arrays.items() if array is not None},
    )


def make_indentation_scale(sensor: SensorSpec, display: DisplayParams) -> ColourScale:
    """Return the fixed scale of indentations of this kind of sensor."""
    group = sensor.sensor_kind.display_group
    return ColourScale(
        colour_map="viridis",
        low=display.get_floor_mm(sensor),
        high=display.get_limit_mm(sensor),
        unit="mm",
        quantity=INDENTATION_LABEL,
        low_setting=f"{group}_floor_mm",
        high_setting=f"{group}_limit_mm",
    )


def make_deviation_scale(
    sensor: SensorSpec, display: DisplayParams, quantity: str = DEVIATION_LABEL
) -> ColourScale:
    """The scale of a distance from rest: either way as far as indentations of this kind of
    sensor go.
    """
    limit = display.get_limit_mm(sensor)
    sets = f"{sensor.sensor_kind.display_group}_limit_mm"
    return ColourScale(
        colour_map="diverging",
        low=-limit,
        high=limit,
        unit="mm",
        quantity=quantity,
        low_setting=sets,
        high_setting=sets,
    )


def _rest_of(
    sensor: SensorSpec,
    camera: Camera,
    reference: NDArray[np.generic] | None,
    shape: tuple[int, ...],
    *,
    recorded: bool,
) -> tuple[NDArray[np.floating], str]:
    """Return the rest surface (rows, cols) of a depth image, and its name if it is not the
    image's own reference.
    """
    if reference is not None and reference.shape == shape:
        return np.asarray(reference, dtype=np.float32), ""
    return sensor.with_camera(
        camera
    ).rest_depth_mm, "; rest: described shape, no reference recorded" if recorded else ""


def make_distance_scale(
    sensor: SensorSpec, display: DisplayParams, reference: NDArray[np.generic] | None
) -> ColourScale:
    """The scale of distances that a bubble's camera can see, wider where the recorded unit is
    built longer.
    """
    low = 10.0 * math.floor((float(sensor.rest_depth_mm.min()) - 10.0) / 10.0)
    farthest = float(sensor.rest_depth_mm.max())
    if reference is not None and np.isfinite(reference).any():
        farthest = max(farthest, float(np.nanpercentile(reference.astype(np.float64), 99.0)))
    low, high = display.get_distance_limits_mm((low, 10.0 * math.ceil(farthest / 10.0)))
    return ColourScale(
        colour_map="viridis",
        low=low,
        high=high,
        unit="mm",
        quantity="distance z from camera",
        low_setting="bubble_near_mm",
        high_setting="bubble_far_mm",
    )


def trace_outline(mask: Mask) -> Floats:
    """Return the outline of a mask as x, y (n, 2) in image coordinates, NaN between its pieces."""
    import cv2

    pieces, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    gap = np.full((1, 2), np.nan, dtype=np.float32)
    parts: list[NDArray[np.float32]] = []
    for piece in pieces:
        if len(piece) < _SHORTEST_PIECE:
            continue
        line = piece[:, 0, :].astype(np.float32) + 0.5
        parts += [line, line[:1], gap]
    return freeze(np.concatenate(parts)) if parts else freeze(np.zeros((0, 2), dtype=np.float32))


def compute_pixel_mm(camera: Camera, sensor: SensorSpec) -> float:
    """Return the width of a pixel on the sensor's surface."""
    return float(np.median(sensor.rest_depth_mm) / camera.fx_px)


def compute_rest_depth_mm(sensor: SensorSpec, camera: Camera) -> NDArray[np.float64]:
    """Return the rest surface (rows, cols) as `camera` sees it."""
    return (
        sensor.rest_depth_mm if camera == sensor.camera else sensor.membrane.rest_depth_mm(camera)
    )


def match_camera(camera: Camera, shape: tuple[int, ...]) -> Camera:
    """Return the camera scaled to the size of an image of another resolution.

    An image of another aspect ratio is shown as well: the method that reads it reports the problem.
    """
    if camera.shape == shape[:2]:
        return camera
    return replace(camera.scale(shape[1] / camera.cols), rows=shape[0], cols=shape[1])


@frozen
class Tile:
    """One preview with its text, truth and difference."""

    title: str
    subtitle: str = ""  # metrics, under the title
    # metrics that another run has too
    metrics: Mapping[str, float] = field(default_factory=dict[str, float])
    preview: Preview | None = None
    truth: Preview | None = None
    difference: Preview | None = None  # the preview minus the truth
    problem: str = ""  # shown over the preview, or in its place
    starts_row: bool = False  # whether it begins a row
    default_mode: str = ""  # comparison mode while none is chosen
