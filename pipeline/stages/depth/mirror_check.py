"""Whether a gel's images are mirrored, where the reference image alone does not show it.

A GelSight Mini's LEDs look nearly alike from left and right. A touch shows it: the slopes of a calibration table are
those of a surface, d(gx)/dy = d(gy)/dx; in a mirrored image one of the two is reversed, and half of what a dent shows
belongs to no surface.
"""

from dataclasses import replace
from typing import cast

import numpy as np

from pipeline.base.arrays import Floats, Image
from pipeline.calibration.calibration_table import Calibration
from pipeline.physics.reference_colours import MirrorDirection, mirror_image
from pipeline.physics.slopes import compute_slopes
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth.change_detection import ImageWindow
from pipeline.stages.depth.illumination.gel_surface import DEFAULT_SMOOTHING_PX, detect_changed_image
from pipeline.stages.depth.illumination.light import downsample_patch, extract_patch, look_up_slopes
from pipeline.stages.depth.poisson import SideBoundaries, integrate_slopes
from pipeline.values.frames import TactileFrame

_LESS_RESIDUAL = 0.8  # mirrored / plain: identifies 9 of 10 balls on a real Mini


def looks_mirrored(
    frame: TactileFrame, source: SensorSpec, calibration: Calibration, direction: MirrorDirection
) -> bool:
    """Whether a touch's slopes are closer to those of a surface when the images are mirrored; False without a touch."""
    image, reference = cast("Image", frame.image), cast("Image", frame.reference)
    changed = detect_changed_image(image, reference, source, calibration)
    if changed is None:
        return False
    still, window = changed.reference.image, changed.window
    plain = _compute_curl_share(image, still, window, source, calibration)
    mirrored = _compute_curl_share(
        mirror_image(image, direction), mirror_image(still, direction),
        _mirror_window(window, direction, image.shape), source, calibration,
    )  # fmt: skip
    return mirrored < _LESS_RESIDUAL * plain


def _compute_curl_share(
    image: Image, reference: Floats, window: ImageWindow, source: SensorSpec, calibration: Calibration
) -> float:
    """The share of the squared slopes that belongs to no surface."""
    patch = extract_patch(image, reference, window, DEFAULT_SMOOTHING_PX, source.markers, calibration.pixel_mm)
    cells = downsample_patch(patch, image.shape)
    gx, gy = look_up_slopes(cells, calibration)
    surface_mm = integrate_slopes(gx, gy, cells.pixel_mm, SideBoundaries("free", "free", "free", "free"))
    slopes = compute_slopes(surface_mm, cells.pixel_mm)
    residual = sum(float(((a - b) ** 2).sum()) for a, b in zip((gx, gy), slopes, strict=True))
    return residual / max(float((gx**2 + gy**2).sum()), 1e-9)


def _mirror_window(window: ImageWindow, direction: MirrorDirection, shape: tuple[int, ...]) -> ImageWindow:
    def mirror_slice(part: slice, n: int) -> slice:
        return slice(n - part.stop, n - part.start)

    changed, weight = (mirror_image(a, direction) for a in (window.changed, window.blend_weight))
    mirrored = replace(window, changed=np.asarray(changed, np.bool_), blend_weight=np.asarray(weight, np.float32))
    if direction == "left to right":
        return replace(mirrored, cols=mirror_slice(window.cols, shape[1]))
    return replace(mirrored, rows=mirror_slice(window.rows, shape[0]))
