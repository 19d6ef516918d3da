"""The part of a gel image that is refined, its illumination, and what every light model can do
with it.
"""

import math
from typing import Literal, NamedTuple

import numpy as np

from pipeline.calibration import slope_model
from pipeline.calibration.calibration_table import Calibration
from pipeline.calibration.markers import inpaint_markers, remove_printed_markers
from pipeline.core.arrays import Floats, Image, Mask
from pipeline.core.frozen import frozen
from pipeline.sensors.spec import Markers, SensorSpec
from pipeline.stages.depth.change_detection import ImageWindow
from pipeline.stages.depth.gel.settings import SURFACE, StepRule
from pipeline.stages.depth.poisson import Integrator


@frozen
class ImagePatch:
    """The changed part of an image, at full resolution or on a coarser grid."""

    x_px: Floats  # (cols,) image coordinates of the columns
    y_px: Floats  # (rows,) image coordinates of the rows
    change: Floats  # (rows, cols, 3) grey levels, smoothed
    reference: Floats  # (rows, cols, 3) reference image, grey levels
    changed: Mask  # (rows, cols) where the surface is estimated
    downsampling: int  # image pixels along one side of a cell
    pixel_mm: float  # width of a cell, by the calibration, which may differ from the sensor's
    smoothing_px: float  # standard deviation of the change's smoothing, image pixels
    # (rows, cols, 3) share of a cell that no printed marker hides, now or in the reference
    unmarked_share: Floats


@frozen
class TouchObservation:
    """A touch that light is fitted to: its image, a first guess of its surface, and the
    integrator of its patch.
    """

    patch: ImagePatch
    surface_mm: Floats  # (rows, cols)
    integrate: Integrator


def extract_patch(
    image: Image,
    reference: Floats,
    window: ImageWindow,
    smoothing_px: float,
    markers: Markers | None,
    pixel_mm: float,
    detected: Mask | None,
) -> ImagePatch:
    """The window of an image (rows, cols, 3).

    Printed markers, now (`detected` (rows, cols)) and in the reference, are inpainted.
    """
    import cv2

    here = (window.rows, window.cols)
    light = np.array(reference[here], np.float32)
    change = image[here].astype(np.float32) - light
    unmarked = np.ones(window.changed.shape, np.float32)
    if markers is not None and detected is not None:
        printed, bright = remove_printed_markers(reference, markers, pixel_mm)
        hidden = printed[here] | detected[here]
        change = inpaint_markers(change, hidden, markers, pixel_mm)
        light = np.array(bright[here])
        unmarked = (~hidden).astype(np.float32)
    if smoothing_px > 0:
        change = np.asarray(cv2.GaussianBlur(change, (0, 0), smoothing_px), np.float32)
    x, y = (np.arange(a.start, a.stop, dtype=np.float32) for a in (window.cols, window.rows))
    return ImagePatch(
        x_px=x,
        y_px=y,
        change=change,
        reference=light,
        changed=window.changed,
        downsampling=1,
        pixel_mm=pixel_mm,
        smoothing_px=smoothing_px,
        unmarked_share=np.asarray(cv2.merge([unmarked] * 3), np.float32),
    )


def downsample_patch(
    patch: ImagePatch, shape: tuple[int, ...], cells: int = SURFACE.grid_cells
) -> ImagePatch:
    """The patch on a grid of at most `cells` cells along an image of `shape`.

    Each cell is the mean of its pixels.

    Lens blur leaves nothing finer in the light.
    """
    by = max(1, round(max(shape) / (cells * patch.downsampling)))
    if by == 1:
        return patch
    rows, cols = (-(-n // by) for n in patch.changed.shape)
    middle = np.float32(0.5 * (by - 1) * patch.downsampling)
    step = by * patch.downsampling
    return ImagePatch(
        x_px=patch.x_px[0] + middle + step * np.arange(cols, dtype=np.float32),
        y_px=patch.y_px[0] + middle + step * np.arange(rows, dtype=np.float32),
        change=compute_cell_means(patch.change, by),
        reference=compute_cell_means(patch.reference, by),
        changed=compute_cell_means(patch.changed.astype(np.float32), by) > 0,
        unmarked_share=compute_cell_means(patch.unmarked_share, by),
        downsampling=step,
        pixel_mm=by * patch.pixel_mm,
        smoothing_px=patch.smoothing_px,
    )


def compute_cell_means(image: Floats, by: int) -> Floats:
    """Means of an image (rows, cols, ...) over cells of `by` x `by` pixels.

    The border is replicated.
    """
    import cv2

    rows, cols = (-(-n // by) for n in image.shape[:2])
    more = (0, rows * by - image.shape[0], 0, cols * by - image.shape[1])
    whole = cv2.copyMakeBorder(image, *more, cv2.BORDER_REPLICATE)
    return np.asarray(cv2.resize(whole, (cols, rows), interpolation=cv2.INTER_AREA), np.float32)


def upsample_surface(surface_mm: Floats, by: int, shape: tuple[int, ...]) -> Floats:
    """A surface of a downsampled patch at image resolution, cropped to `shape` (rows, cols)."""
    import cv2

    if by == 1:
        return surface_mm
    rows, cols = surface_mm.shape
    fine = cv2.resize(surface_mm, (cols * by, rows * by), interpolation=cv2.INTER_CUBIC)
    return np.ascontiguousarray(fine[: shape[0], : shape[1]], np.float32)


def look_up_slopes(patch: ImagePatch, calibration: Calibration) -> tuple[Floats, Floats]:
    """Slopes (gx, gy) (rows, cols) in mm/mm that the calibration table gives for the patch."""
    places = slope_model.locate(patch.x_px, patch.y_px, (calibration.rows, calibration.cols))
    change = patch.change * slope_model.compute_gain(patch.reference)
    return slope_model.evaluate(calibration.model, change, *places, patch.changed)


def blur_change(change: Floats, patch: ImagePatch, lens_blur_px: float) -> Floats:
    """A change (rows, cols, 3) after the lens blur and the patch's smoothing."""
    import cv2

    width = math.hypot(lens_blur_px, patch.smoothing_px) / patch.downsampling
    return (
        np.asarray(cv2.GaussianBlur(change, (0, 0), width), np.float32)
        if width > SURFACE.no_blur_px
        else change
    )


def simulate_recorded_change(change: Floats, patch: ImagePatch, lens_blur_px: float) -> Floats:
    """What the camera records of a change of light (rows, cols, 3): blurred, and clipped to
    0-255.
    """
    recorded = np.clip(blur_change(change, patch, lens_blur_px) + patch.reference, 0.0, 255.0)
    return np.asarray(recorded - patch.reference, np.float32)


def sum_change_grey(patch: ImagePatch) -> float:
    """Sum of the absolute change in grey levels, cut and weighted as misfits are."""
    change = np.minimum(
        np.abs(patch.change * patch.unmarked_share), np.float32(2.0 * SURFACE.huber_grey)
    )
    return float(change[patch.changed].sum())


IlluminationModel = Literal["described", "trusted", "near", "leds", "field"]


@frozen
class Illumination:
    """Parameters of the light that a frame is read by.

    model: "described" and "trusted" are the LEDs of the sensor's description; trusted light is
    known to explain the image. "near" scales the described light by what LEDs close to the gel
    change of it. "leds" are LEDs fitted to the sensor instance, as deviations from the description.
    "field" is a smooth shading field.
    """

    model: IlluminationModel = "described"
    # of fitted models: deviations (`led_light`), or coefficients
    parameters: tuple[float, ...] = ()
    # (n * n,) of a recording's field, whose frames differ in how far it holds: `sum_covariance`
    covariance: tuple[float, ...] = ()
    from_context: bool = False  # chosen by the context frames, not by the frame itself

    def __post_init__(self) -> None:
        """Accept numbers as an array, as a file holds them."""
        for name in ("parameters", "covariance"):
            object.__setattr__(self, name, tuple(float(value) for value in getattr(self, name)))

    @property
    def is_trusted(self) -> bool:
        """Whether LEDs of a usual instance explain the image, so that each pixel counts by its
        certainty.
        """
        return self.model in {"leds", "trusted"}

    @property
    def is_bound_to_place(self) -> bool:
        """Whether touches at one place err alike: the light is not fitted to each by itself, or
        by LEDs alone.
        """
        return self.model in {"described", "trusted", "near"}

    @property
    def is_fitted_leds(self) -> bool:
        """Whether the LEDs differ from the description."""
        return self.model == "leds" and any(self.parameters)


@frozen
class FrameLight:
    """What a frame is measured by: its light and its calibration table."""

    illumination: Illumination | None  # None where the calibration table contains its own light
    calibration: Calibration  # the description's where presses cover no part of the touch
    notes: tuple[str, ...] = ()


class RenderedChange(NamedTuple):
    """Change of the light of a surface against the reference image, before the lens, each (rows,
    cols, 3).
    """

    change: Floats  # grey levels
    rate_x: Floats  # its derivatives by the slopes, grey levels per mm/mm
    rate_y: Floats


@frozen
class Light:
    """A light model, prepared for one image patch."""

    source: SensorSpec
    patch: ImagePatch
    step_rule: StepRule  # how an iteration moves the slopes
    blur_px: float  # standard deviation of the lens blur, in image pixels

    def render(self, surface_mm: Floats, gx: Floats, gy: Floats) -> RenderedChange:
        """Render the light of a surface (rows, cols) with these slopes."""
        raise NotImplementedError
