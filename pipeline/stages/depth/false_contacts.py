"""Which regions of a surface something presses into, and which drifting light leaves beside a touch."""

from __future__ import annotations

import numpy as np

from pipeline.base.arrays import Floats, Mask
from pipeline.base.ranks import median, percentile
from pipeline.physics.slopes import compute_slopes

_FLANK, _FLANK_SHARE = 0.12, 0.1  # mm/mm, and of a region's pixels
_FLANK_OF_DEEPEST = 0.7  # of the steepest tenth of the deepest region, where a light touch has nothing steeper
_STEP_PX = 7  # a step that is smoothed, to both sides
_STANDS_OUT = 0.5  # of its own depth: simulated second touches of 0.05 mm and more stand out by 0.64 to 1.1
_RING_MM = (0.25, 0.8)  # how far from it what lies around it lies
_BORDER_SHARE = 0.4  # of the deepest region: corners beside a real GelSlim's presses come out up to 0.36


def remove_false_contacts(
    touched: Mask, surface_mm: Floats, pixel_mm: float, border: Mask | None = None, moved: Mask | None = None
) -> Mask:
    """`touched` without the broad, shallow regions that drifting light leaves beside a touch; the deepest one stays.

    What presses has flanks: some of its region is steep, and not where the part that is looked at, `moved`, ends: a
    surface that drifting light has raised there ends in a step. It stands out from what lies around it. On the image's
    `border`, beyond which nothing holds the surface, it must be a good part as deep as the deepest too: the corners of
    a picture are where light is least known.
    """
    import cv2

    n, found = cv2.connectedComponents(touched.astype(np.uint8), connectivity=8)
    if n <= 2:  # the background and one region
        return touched
    regions = np.asarray(found, np.int32)
    depths = np.full(n, -np.inf, np.float32)
    np.maximum.at(depths, regions[touched], surface_mm[touched])
    depths = depths[1:]
    slope = np.asarray(cv2.magnitude(*compute_slopes(surface_mm, pixel_mm)), np.float32)
    steepest = float(percentile(slope, 90.0, regions == 1 + int(np.argmax(depths))))
    steep = np.asarray(slope > min(_FLANK, _FLANK_OF_DEEPEST * steepest), np.bool_)
    if moved is not None:
        steep &= _well_within(moved)
    keep = np.bincount(regions[touched & steep], minlength=n) > _FLANK_SHARE * np.bincount(regions.ravel(), minlength=n)
    if border is not None:
        cut = np.unique(regions[touched & border])
        keep[cut[depths[cut - 1] < _BORDER_SHARE * float(depths.max())]] = False
    deepest = 1 + int(np.argmax(depths))
    keep[0] = keep[deepest] = False
    for k in np.flatnonzero(keep):
        keep[k] = _stands_out(np.equal(regions, k), touched, surface_mm, pixel_mm)
    keep[deepest] = True
    return np.asarray(keep[regions], np.bool_)


def _well_within(moved: Mask) -> Mask:
    """What lies farther from the end of `moved` than a smoothed step reaches; the picture's border is no end."""
    import cv2

    return np.asarray(
        cv2.erode(moved.astype(np.uint8), np.ones((_STEP_PX, _STEP_PX), np.uint8), borderValue=1), np.bool_
    )


def _stands_out(region: Mask, touched: Mask, surface_mm: Floats, pixel_mm: float) -> bool:
    """Whether a region lies deeper than what is not touched around it by a good part of its depth."""
    import cv2

    near_px, far_px = (max(1, round(mm / pixel_mm)) for mm in _RING_MM)
    left, top, wide, tall = cv2.boundingRect(region.astype(np.uint8))
    around = far_px + near_px
    here = tuple(slice(max(0, first - around), first + n + around) for first, n in ((top, tall), (left, wide)))
    ring = _grown(region[here], far_px) & ~_grown(touched[here], near_px)
    if not ring.any():
        return True
    own = median(surface_mm, region)
    return bool(own - median(surface_mm[here], ring) > _STANDS_OUT * own)


def _grown(mask: Mask, by_px: int) -> Mask:
    import cv2

    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * by_px + 1, 2 * by_px + 1))
    return np.asarray(cv2.dilate(mask.astype(np.uint8), disc), np.bool_)
