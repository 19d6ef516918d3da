"""The surface of what has changed in a gel's picture, and the light that it is read by."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from pipeline.base.arrays import Floats, Image
from pipeline.base.errors import CalibrationError
from pipeline.base.progress import Progress
from pipeline.base.ranks import median
from pipeline.calibration.calibration_table import Calibration, compute_slopes
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth import adaptive_illumination, led_calibration, surface_refinement
from pipeline.stages.depth.change_detection import ImageWindow
from pipeline.stages.depth.drift import DriftedReference
from pipeline.stages.depth.poisson import Boundary, Integrator, SideBoundaries, integrate_slopes
from pipeline.stages.depth.surface_refinement import ImagePatch


@dataclass(frozen=True, slots=True, kw_only=True)
class ChangedImage:
    """A picture in which something has moved, and how it is looked at."""

    image: Image
    reference: DriftedReference
    window: ImageWindow
    source: SensorSpec
    calibration: Calibration
    smoothing_px: float
    boundary: Boundary


def estimate_surface(
    changed: ChangedImage, iterations: int, light: adaptive_illumination.Illumination | None, progress: Progress
) -> tuple[Floats, adaptive_illumination.Illumination | None]:
    """The surface of the window in mm, its rest still to be found, and the light that it was read by.

    It can be stopped at every round.
    """
    window, pixel_mm = changed.window, changed.calibration.pixel_mm

    def integrate_window(gx: Floats, gy: Floats) -> Floats:
        progress.step(0.6, "integrating slopes")
        return _integrated(gx, gy, changed, window, pixel_mm)

    if not surface_refinement.is_applicable(changed.source, changed.calibration):
        return integrate_window(*_looked_up(changed)), None
    picture, small = _seen(changed)
    integrates = _integrates(changed, progress)
    guess = _guess(small, changed, integrates)
    found, light = adaptive_illumination.fit_illumination(guess, small, changed.source, integrates, iterations, light)
    if small is not picture:
        found = surface_refinement.upsample_surface(found, small.downsampling, window.changed.shape)
        found = adaptive_illumination.refine_in_light(
            light, found, picture, changed.source, integrate_window, 1, cg_steps=surface_refinement.FINE_CG_STEPS
        )  # fmt: skip
    return found, light


def estimate_led_observation(changed: ChangedImage, progress: Progress) -> led_calibration.LedObservation:
    """What the picture says of its unit's lamps; for a look-up to which the sensor's own light `applies`."""
    _, small = _seen(changed)
    integrates = _integrates(changed, progress)
    guess = _guess(small, changed, integrates)
    found, _ = surface_refinement.refine_surface(guess, small, changed.source, "even", integrates(small))
    return adaptive_illumination.make_led_observation(found, small, changed.source, integrates)


def _seen(changed: ChangedImage) -> tuple[ImagePatch, ImagePatch]:
    """The window at the picture's own pixels, and on the grid of the rounds."""
    picture = surface_refinement.extract_patch(
        changed.image, changed.reference.image, changed.window, changed.smoothing_px, changed.source.markers,
        changed.calibration.pixel_mm,
    )  # fmt: skip
    return picture, surface_refinement.downsample_patch(picture, changed.image.shape)


def _integrates(changed: ChangedImage, progress: Progress) -> adaptive_illumination.IntegratorFactory:
    def make_integrator(cells: ImagePatch) -> Integrator:
        window = replace(changed.window, changed=cells.changed)

        def integrate_patch(gx: Floats, gy: Floats) -> Floats:
            progress.step(0.4, "integrating slopes")
            return _integrated(gx, gy, changed, window, cells.pixel_mm)

        return integrate_patch

    return make_integrator


def _guess(small: ImagePatch, changed: ChangedImage, integrates: adaptive_illumination.IntegratorFactory) -> Floats:
    return integrates(small)(*_finite(*surface_refinement.look_up_slopes(small, changed.calibration), changed.source))


def _looked_up(changed: ChangedImage) -> tuple[Floats, Floats]:
    """The slopes of the window by the look-up alone."""
    window = changed.window
    here = (window.rows, window.cols)
    gx, gy = compute_slopes(
        changed.calibration, changed.image[here], changed.reference.image[here], window.changed,
        (window.rows.start, window.cols.start), markers=changed.source.markers, smoothing_px=changed.smoothing_px,
    )  # fmt: skip
    return _finite(gx, gy, changed.source)


def _finite(gx: Floats, gy: Floats, source: SensorSpec) -> tuple[Floats, Floats]:
    if not math.isfinite(float(gx.sum()) + float(gy.sum())):
        raise CalibrationError(f"the look-up of {source.name} gives slopes that are no numbers; calibrate again")
    return gx, gy


def _integrated(gx: Floats, gy: Floats, changed: ChangedImage, window: ImageWindow, pixel_mm: float) -> Floats:
    """The integrated indentations (..., rows, cols) of the window, level at their rest outside what has moved.

    A touch at the image border is free there: the gel beyond is not seen, and not known to be at rest.
    """
    rows, cols = changed.image.shape[:2]
    inside = (window.cols.start > 0, window.cols.stop < cols, window.rows.start > 0, window.rows.stop < rows)
    ends: list[Boundary] = [changed.boundary if held else "free" for held in inside]
    z = integrate_slopes(gx, gy, pixel_mm, SideBoundaries(*ends))
    outside = ~window.changed
    if not outside.any():
        return z - z.min(axis=(-2, -1), keepdims=True)
    images = z.reshape(-1, *z.shape[-2:])
    level = np.array([median(image, outside) for image in images], np.float32)
    return (images - level[:, None, None]).reshape(z.shape)
