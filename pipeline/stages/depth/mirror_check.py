"""Whether a gel's images are mirrored, where the reference image alone does not show it.

A GelSight Mini's LEDs look nearly alike from left and right. A touch shows it: the slopes of a calibration table are
those of a surface, d(gx)/dy = d(gy)/dx; in a mirrored image one of the two is reversed, and half of what a dent shows
belongs to no surface.
"""

from dataclasses import replace

import numpy as np

from pipeline.base.arrays import Floats, Image
from pipeline.physics.reference_colours import MirrorDirection, compare_colours, mirror_image
from pipeline.physics.slopes import compute_slopes
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth.change_detection import ImageWindow
from pipeline.stages.depth.gel.slopes import ChangedImage
from pipeline.stages.depth.illumination.light import downsample_patch, extract_patch, look_up_slopes
from pipeline.stages.depth.poisson import SideBoundaries, integrate_slopes

_LESS_RESIDUAL = 0.8  # mirrored / plain: identifies 9 of 10 balls on a real Mini


def describe_mirroring(reference: Image, source: SensorSpec, changed: ChangedImage) -> str:
    """How a touch shows that the images are mirrored, as a clause; "" where it does not, or they are not."""
    how = None if source.optics is None else compare_colours(reference, source).possible_mirroring
    if how is None or not looks_mirrored(changed, how):
        return ""
    return f"the images look mirrored {how}: only then are the touch's slopes those of a surface"


def looks_mirrored(changed: ChangedImage, direction: MirrorDirection) -> bool:
    """Whether a touch's slopes are closer to those of a surface when the images are mirrored."""
    still, window = changed.reference.image, changed.window
    plain = _compute_curl_share(changed.image, still, window, changed)
    mirrored = _compute_curl_share(
        mirror_image(changed.image, direction), mirror_image(still, direction),
        _mirror_window(window, direction, changed.image.shape), changed,
    )  # fmt: skip
    return mirrored < _LESS_RESIDUAL * plain


def _compute_curl_share(image: Image, reference: Floats, window: ImageWindow, changed: ChangedImage) -> float:
    """The share of the squared slopes that belongs to no surface."""
    calibration = changed.calibration
    patch = extract_patch(image, reference, window, changed.smoothing_px, changed.source.markers, calibration.pixel_mm)
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
