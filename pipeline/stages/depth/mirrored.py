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
from pipeline.calibration.lookup import Calibration
from pipeline.physics.colours import Mirrored, mirrored
from pipeline.physics.slopes import slopes
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth import drift, gel_light, moved
from pipeline.stages.depth.moved import Window
from pipeline.stages.depth.poisson import Sides, integrate
from pipeline.values.frames import TactileFrame

_BENDS_BETTER = 0.8  # of what no surface has: 9 of 10 balls on a real Mini are told by it


def looks_mirrored(frame: TactileFrame, source: SensorSpec, calibration: Calibration, how: Mirrored) -> bool:
    """Whether a touch's slopes are nearer to a surface's when a gel's pictures are mirrored; False without a touch."""
    image, reference = cast("Image", frame.image), cast("Image", frame.reference)
    still = drift.stilled(image, reference)
    window = moved.window(image, still.grey, source.limits.no_touch, calibration.pixel_mm)
    if window is None:
        return False
    plain = _no_surface(image, still.picture, window, source, calibration)
    turned = _no_surface(
        mirrored(image, how), mirrored(still.picture, how), _mirrored_window(window, how, image.shape), source,
        calibration,
    )  # fmt: skip
    return turned < _BENDS_BETTER * plain


def _no_surface(image: Image, still: Floats, window: Window, source: SensorSpec, calibration: Calibration) -> float:
    """The share of the slopes' squares that no surface has."""
    picture = gel_light.seen(image, still, window, 1.0, source.markers, calibration.pixel_mm)
    small = gel_light.coarser(picture, image.shape)
    gx, gy = gel_light.rough_slopes(small, calibration)
    bent = slopes(integrate(gx, gy, small.pixel_mm, Sides("free", "free", "free", "free")), small.pixel_mm)
    left = sum(float(((a - b) ** 2).sum()) for a, b in zip((gx, gy), bent, strict=True))
    return left / max(float((gx**2 + gy**2).sum()), 1e-9)


def _mirrored_window(window: Window, how: Mirrored, shape: tuple[int, ...]) -> Window:
    def back(part: slice, n: int) -> slice:
        return slice(n - part.stop, n - part.start)

    moved_part, share = (mirrored(a, how) for a in (window.moved, window.share))
    turned = replace(window, moved=np.asarray(moved_part, np.bool_), share=np.asarray(share, np.float32))
    if how == "left to right":
        return replace(turned, cols=back(window.cols, shape[1]))
    return replace(turned, rows=back(window.rows, shape[0]))
