"""Node *slopes*: the slopes of a gel where its image has changed, by the calibration table."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import cast

import numpy as np

from pipeline.calibration.calibration_table import Calibration
from pipeline.core.arrays import Floats, Image, Mask
from pipeline.core.errors import CalibrationError, StageWarning
from pipeline.core.frozen import frozen
from pipeline.core.progress import Progress
from pipeline.core.values.frames import TactileFrame
from pipeline.physics.optics import compute_slopes
from pipeline.physics.reference_colours import MirrorDirection, compare_colours
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth import change_detection
from pipeline.stages.depth.change_detection import ImageWindow
from pipeline.stages.depth.gel.change import FrameChange
from pipeline.stages.depth.gel.drift import RestImage
from pipeline.stages.depth.gel.rest import RestState
from pipeline.stages.depth.gel.settings import CONTACT, SLOPES
from pipeline.stages.depth.illumination.light import (
    FrameLight,
    ImagePatch,
    downsample_patch,
    extract_patch,
    look_up_slopes,
)
from pipeline.stages.depth.poisson import Boundary, Integrator, SideBoundaries, integrate_slopes


@frozen
class SlopeParams:
    """Parameters of the node."""

    sensitivity: float = 1.0  # divides the sensor's limit of change without contact
    smoothing_px: float = 1.0  # standard deviation of the blur of the change, image pixels


@dataclass(frozen=True, kw_only=True)  # without slots, which a cached property needs
class ChangedImage:
    """An image with a change, and the settings it is measured by."""

    image: Image
    reference: RestImage
    window: ImageWindow
    source: SensorSpec
    calibration: Calibration
    smoothing_px: float
    markers: Mask | None  # (rows, cols) what printed markers hide of the image, if there are any

    @cached_property
    def patches(self) -> tuple[ImagePatch, ImagePatch]:
        """The window at image resolution, and on the refinement grid."""
        patch = extract_patch(
            self.image,
            self.reference.image,
            self.window,
            self.smoothing_px,
            self.source.markers,
            self.calibration.pixel_mm,
            self.markers,
        )
        return patch, downsample_patch(patch, self.image.shape)

    def make_integrator(
        self, patch: ImagePatch, progress: Progress, fraction: float = 0.4
    ) -> Integrator:
        """The integrator of a patch's slopes: surfaces are 0 in the median outside the changed
        region.
        """
        outside = np.flatnonzero(~patch.changed)
        window = self.window
        return Integrator(
            pixel_mm=patch.pixel_mm,
            sides=find_boundaries(window.rows, window.cols, self.image.shape),
            level_at=outside[:: max(1, len(outside) // SLOPES.level_pixels)],
            progress=progress,
            fraction=fraction,
        )

    def guess_surface(self, patch: ImagePatch, integrate: Integrator) -> Floats:
        """The surface (rows, cols) in mm by the calibration table alone."""
        slopes = look_up_slopes(patch, self.calibration)
        _check_slopes(*slopes, self.source)
        return integrate(*slopes)


def find_boundaries(rows: slice, cols: slice, shape: tuple[int, ...]) -> SideBoundaries:
    """The boundary condition on each side of a part of an image of `shape`.

    The gel is at rest around a touch. At the image border it is free: the gel beyond is not
    visible, and not known to be at rest.
    """
    ends: list[Boundary] = [
        "flat" if is_inside else "free"
        for part, n in zip((cols, rows), (shape[1], shape[0]), strict=True)
        for is_inside in (part.start > 0, part.stop < n)
    ]
    return SideBoundaries(*ends)


@frozen
class FrameSlopes:
    """Slopes of the changed part of an image by the calibration table."""

    changed: ChangedImage
    # (rows, cols) mm/mm, x right: of the refinement grid where light corrects them, else of the
    # window
    gx: Floats
    gy: Floats
    notes: tuple[str, ...]


def measure_slopes(
    frame: TactileFrame,
    rest: RestState,
    change: FrameChange,
    light: FrameLight,
    params: SlopeParams,
    progress: Progress,
) -> FrameSlopes:
    """Slopes of a press by the calibration table, around what has changed."""
    progress.step(0.0, "looking up slopes")
    changed = make_changed_image(
        cast("Image", frame.image), rest, change, light.calibration, params
    )
    patch, cells = changed.patches
    slopes = look_up_slopes(cells if light.illumination else patch, light.calibration)
    _check_slopes(*slopes, rest.source)
    notes = _warn_of_image(changed)
    return FrameSlopes(changed=changed, gx=slopes[0], gy=slopes[1], notes=notes)


def make_changed_image(
    image: Image,
    rest: RestState,
    change: FrameChange,
    calibration: Calibration,
    params: SlopeParams | None = None,
) -> ChangedImage:
    """The press of an image (rows, cols, 3) and the window around it, by default settings for
    `params` None.
    """
    params = SlopeParams() if params is None else params
    limit_grey = rest.source.limits.no_contact_change / params.sensitivity
    window = change_detection.detect_press(
        image,
        change.rest.image_8bit,
        limit_grey,
        calibration.pixel_mm,
        change.press.dent_mm,
    )
    return ChangedImage(
        image=image,
        reference=change.rest,
        window=window,
        source=rest.source,
        calibration=calibration,
        smoothing_px=params.smoothing_px,
        markers=change.markers,
    )


def _warn_of_image(changed: ChangedImage) -> tuple[str, ...]:
    """Notes on slopes that the image does not show: under markers, and where it is saturated."""
    import cv2

    window = changed.window
    notes = list[str]()
    if changed.source.markers is not None:
        notes.append("slopes under the printed markers were filled in from around them")
    red, green, blue = cv2.split(changed.image[window.rows, window.cols])
    clipped = np.asarray(cv2.max(cv2.max(red, green), blue)) >= SLOPES.saturated_grey
    share = np.count_nonzero(clipped & window.changed) / np.count_nonzero(window.changed)
    if share > SLOPES.saturated_share:
        notes.append(
            StageWarning(
                f"{share:.0%} of the touch is saturated: slopes there may be wrong; expose less"
            )
        )
    return tuple(notes)


def _check_slopes(gx: Floats, gy: Floats, source: SensorSpec) -> None:
    """Raise CalibrationError for slopes that are not finite."""
    if not math.isfinite(float(gx.sum()) + float(gy.sum())):
        raise CalibrationError(
            f"the calibration table of {source.name} gives slopes that are not finite; calibrate "
            "again"
        )


def describe_mirroring(reference: Image, source: SensorSpec, changed: ChangedImage) -> str:
    """How a touch shows that the images are mirrored, as a clause.

    "" where it does not, or they are not.

    A GelSight Mini's LEDs look nearly alike from left and right, so its reference image does not
    show it. A touch does: the slopes of a calibration table are those of a surface, d(gx)/dy =
    d(gy)/dx; in a mirrored image one of the two is reversed, and half of what a dent shows belongs
    to no surface.
    """
    how = compare_colours(reference, source).possible_mirroring
    if how is None or not looks_mirrored(changed, how):
        return ""
    return f"the images look mirrored {how}: only then are the touch's slopes those of a surface"


def looks_mirrored(changed: ChangedImage, direction: MirrorDirection) -> bool:
    """Whether a touch's slopes are closer to those of a surface with one of the two reversed."""
    _, cells = changed.patches
    gx, gy = look_up_slopes(cells, changed.calibration)
    mirrored = (-gx, gy) if direction == "left to right" else (gx, -gy)
    shares = [_compute_curl_share(*g, cells.pixel_mm) for g in (mirrored, (gx, gy))]
    return shares[0] < CONTACT.mirrored_curl * shares[1]


def _compute_curl_share(gx: Floats, gy: Floats, pixel_mm: float) -> float:
    """The share of the squared slopes that belongs to no surface."""
    slopes = compute_slopes(integrate_slopes(gx, gy, pixel_mm), pixel_mm)
    residual = sum(float(((a - b) ** 2).sum()) for a, b in zip((gx, gy), slopes, strict=True))
    return residual / max(float((gx**2 + gy**2).sum()), 1e-9)
