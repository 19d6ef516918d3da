"""Whether a gel's pictures are mirrored, where the untouched one alone does not tell.

A GelSight Mini's lights look nearly alike from left and right. A touch tells: the slopes that a look-up reads are those
of a surface, which bends alike along both axes, d(gx)/dy = d(gy)/dx; those of a mirrored picture turn one of the two
about, and of what a dent then has no surface has half.
"""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import numpy as np

from pipeline.base.arrays import Floats, Image
from pipeline.calibration.calibration_table import Calibration
from pipeline.physics.reference_colours import MirrorDirection, mirror_image
from pipeline.physics.slopes import compute_slopes
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth import change_detection, drift
from pipeline.stages.depth.change_detection import ImageWindow
from pipeline.stages.depth.illumination import image_patch
from pipeline.stages.depth.poisson import SideBoundaries, integrate_slopes
from pipeline.values.frames import TactileFrame

_BENDS_BETTER = 0.8  # of what no surface has: 9 of 10 balls on a real Mini are told by it


def looks_mirrored(frame: TactileFrame, source: SensorSpec, calibration: Calibration, how: MirrorDirection) -> bool:
    """Whether a touch's slopes are nearer to a surface's when a gel's pictures are mirrored; False without a touch."""
    image, reference = cast("Image", frame.image), cast("Image", frame.reference)
    still = drift.apply_estimated_drift(image, reference)
    window = change_detection.detect_change(
        image, still.image_8bit, source.limits.no_contact_change, calibration.pixel_mm
    )
    if window is None:
        return False
    plain = _no_surface(image, still.image, window, source, calibration)
    turned = _no_surface(
        mirror_image(image, how), mirror_image(still.image, how), _mirrored_window(window, how, image.shape), source,
        calibration,
    )  # fmt: skip
    return turned < _BENDS_BETTER * plain


def _no_surface(
    image: Image, still: Floats, window: ImageWindow, source: SensorSpec, calibration: Calibration
) -> float:
    """The share of the slopes' squares that no surface has."""
    picture = image_patch.extract_patch(image, still, window, 1.0, source.markers, calibration.pixel_mm)
    small = image_patch.downsample_patch(picture, image.shape)
    gx, gy = image_patch.look_up_slopes(small, calibration)
    bent = compute_slopes(
        integrate_slopes(gx, gy, small.pixel_mm, SideBoundaries("free", "free", "free", "free")), small.pixel_mm
    )
    left = sum(float(((a - b) ** 2).sum()) for a, b in zip((gx, gy), bent, strict=True))
    return left / max(float((gx**2 + gy**2).sum()), 1e-9)


def _mirrored_window(window: ImageWindow, how: MirrorDirection, shape: tuple[int, ...]) -> ImageWindow:
    def mirror_slice(part: slice, n: int) -> slice:
        return slice(n - part.stop, n - part.start)

    moved_part, share = (mirror_image(a, how) for a in (window.changed, window.blend_weight))
    turned = replace(window, changed=np.asarray(moved_part, np.bool_), blend_weight=np.asarray(share, np.float32))
    if how == "left to right":
        return replace(turned, cols=mirror_slice(window.cols, shape[1]))
    return replace(turned, rows=mirror_slice(window.rows, shape[0]))
