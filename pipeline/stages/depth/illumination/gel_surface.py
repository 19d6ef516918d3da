"""The surface of a gel where its image has changed."""

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pipeline.base.arrays import Floats, Image, median
from pipeline.base.errors import CalibrationError
from pipeline.base.memo import Memo
from pipeline.base.progress import Progress
from pipeline.calibration.calibration_table import Calibration, compute_slopes
from pipeline.engine.digests import compute_cached_digest
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth import change_detection
from pipeline.stages.depth.change_detection import ImageWindow
from pipeline.stages.depth.gel import coarse_light
from pipeline.stages.depth.gel.change import Change, explain_change, make_unexplained_change
from pipeline.stages.depth.gel.rest import Rest, estimate_exposure, estimate_rest, remove_exposure
from pipeline.stages.depth.illumination import selection
from pipeline.stages.depth.illumination.light import (
    Illumination,
    ImagePatch,
    downsample_patch,
    extract_patch,
    look_up_slopes,
    upsample_surface,
)
from pipeline.stages.depth.poisson import Boundary, Integrator, SideBoundaries, integrate_slopes

DEFAULT_SMOOTHING_PX = 1.0  # standard deviation, image pixels


@dataclass(frozen=True, kw_only=True)  # without slots, which a cached property needs
class ChangedImage:
    """An image with a change, and the settings it is measured by."""

    image: Image
    reference: Rest
    window: ImageWindow
    source: SensorSpec
    calibration: Calibration
    smoothing_px: float = DEFAULT_SMOOTHING_PX
    boundary: Boundary = "flat"

    @cached_property
    def patches(self) -> tuple[ImagePatch, ImagePatch]:
        """The window at image resolution, and on the refinement grid."""
        patch = extract_patch(
            self.image, self.reference.image, self.window, self.smoothing_px, self.source.markers,
            self.calibration.pixel_mm,
        )  # fmt: skip
        return patch, downsample_patch(patch, self.image.shape)

    def make_integrator(self, patch: ImagePatch, progress: Progress, fraction: float = 0.4) -> Integrator:
        """The integrator of a patch's slopes; it can be cancelled at every use."""
        window = replace(self.window, changed=patch.changed)

        def integrate(gx: Floats, gy: Floats) -> Floats:
            progress.step(fraction, "integrating slopes")
            return _integrate_window(gx, gy, self, window, patch.pixel_mm)

        return integrate

    def guess_surface(self, patch: ImagePatch, integrate: Integrator) -> Floats:
        """The surface (rows, cols) in mm by the calibration table alone."""
        return integrate(*_check_slopes(*look_up_slopes(patch, self.calibration), self.source))


@dataclass(frozen=True, slots=True, kw_only=True)
class Observation:
    """What a frame shows before any surface is measured."""

    change: Change
    rest: Rest


def observe(
    image: Image, reference: Image, source: SensorSpec, pixel_mm: float, touches: tuple[Image, ...] = ()
) -> Observation:
    """Press or drift, and the rest image (rows, cols, 3); `touches` are others of the same instance."""
    arrays = (compute_cached_digest(a) for a in (image, reference, source, touches))

    def make() -> Observation:
        if source.optics is None:  # no light to explain a change by: what drift leaves is a press
            change = make_unexplained_change("none")
            rest = estimate_rest(image, reference, change)
            limit_grey = source.limits.no_contact_change
            if change_detection.detect_change(image, rest.image_8bit, limit_grey, pixel_mm) is not None:
                change = make_unexplained_change("press")
            return Observation(change=change, rest=rest)
        light = coarse_light.estimate_light(touches, reference, source, pixel_mm)
        exposed = remove_exposure(image, estimate_exposure(image, reference))
        change = explain_change(exposed, reference, source, light, pixel_mm)
        return Observation(change=change, rest=estimate_rest(image, reference, change))

    return _observations.get_or_make((*arrays, str(pixel_mm)), make)


_observations: Memo[tuple[str, ...], Observation] = Memo(
    8
)  # the check for contact, the light and the stage need the same


def detect_changed_image(
    image: Image, reference: Image, source: SensorSpec, calibration: Calibration, touches: tuple[Image, ...] = ()
) -> ChangedImage | None:
    """The press of an image against its reference (rows, cols, 3), by default settings.

    None without a press, or for one that is measured without its light.
    """
    seen = observe(image, reference, source, calibration.pixel_mm, touches)
    if seen.change.verdict != "press" or (seen.change.is_smooth and uses_illumination(source, calibration)):
        return None
    window = change_detection.detect_press(
        image, seen.rest.image_8bit, source.limits.no_contact_change, calibration.pixel_mm, seen.change.dent_mm
    )
    return ChangedImage(image=image, reference=seen.rest, window=window, source=source, calibration=calibration)


def uses_illumination(source: SensorSpec, calibration: Calibration) -> bool:
    """Whether the surface is corrected: for described optics, and a table that was derived from them.

    A table that was fitted to indentations contains their shadows and blur.
    """
    return source.optics is not None and calibration.is_built_in


def estimate_surface(
    changed: ChangedImage, illumination: Illumination, progress: Progress, *, draft: bool = False
) -> Floats:
    """The surface (rows, cols) of the window in mm, before it is levelled; it can be cancelled at every iteration."""
    window, source = changed.window, changed.source
    if not uses_illumination(source, changed.calibration):
        progress.step(0.6, "integrating slopes")
        return _integrate_window(*_look_up_window(changed), changed, window, changed.calibration.pixel_mm)
    patch, cells = changed.patches
    integrate = changed.make_integrator(cells, progress)
    guess = changed.guess_surface(cells, integrate)
    surface = selection.correct_surface(guess, cells, source, illumination, integrate, draft=draft)
    if cells is patch:
        return surface
    surface = upsample_surface(surface, cells.downsampling, window.changed.shape)
    return selection.add_detail(surface, patch, source, illumination, changed.make_integrator(patch, progress, 0.6))


def _look_up_window(changed: ChangedImage) -> tuple[Floats, Floats]:
    """Slopes (gx, gy) (rows, cols) of the window by the calibration table alone."""
    window = changed.window
    here = (window.rows, window.cols)
    gx, gy = compute_slopes(
        changed.calibration, changed.image[here], changed.reference.image[here], window.changed,
        (window.rows.start, window.cols.start), markers=changed.source.markers, smoothing_px=changed.smoothing_px,
    )  # fmt: skip
    return _check_slopes(gx, gy, changed.source)


def _check_slopes(gx: Floats, gy: Floats, source: SensorSpec) -> tuple[Floats, Floats]:
    if not math.isfinite(float(gx.sum()) + float(gy.sum())):
        raise CalibrationError(
            f"the calibration table of {source.name} gives slopes that are not finite; calibrate again"
        )
    return gx, gy


def _integrate_window(gx: Floats, gy: Floats, changed: ChangedImage, window: ImageWindow, pixel_mm: float) -> Floats:
    """The indentations (..., rows, cols) in mm of the window, 0 in the median outside the changed region.

    A touch at the image border is free there: the gel beyond is not visible, and not known to be at rest.
    """
    rows, cols = changed.image.shape[:2]
    inside = (window.cols.start > 0, window.cols.stop < cols, window.rows.start > 0, window.rows.stop < rows)
    ends: list[Boundary] = [changed.boundary if is_inside else "free" for is_inside in inside]
    z = integrate_slopes(gx, gy, pixel_mm, SideBoundaries(*ends))
    outside = ~window.changed
    if not outside.any():
        return z - z.min(axis=(-2, -1), keepdims=True)
    images = z.reshape(-1, *z.shape[-2:])
    level = np.array([median(image, outside) for image in images], np.float32)
    return (images - level[:, None, None]).reshape(z.shape)
