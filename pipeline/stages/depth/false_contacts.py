"""Removal of false contacts: broad, shallow regions that drift of the light leaves next to a
touch.
"""

import numpy as np

from pipeline.core.arrays import Floats, Mask, median, percentile
from pipeline.physics.optics import compute_slopes

# mm/mm of a flank, and its least share of a region's pixels
_FLANK = 0.12
_FLANK_SHARE = 0.1
# of the steepest tenth of the deepest region, where a light touch has nothing steeper
_FLANK_OF_DEEPEST = 0.7
_STEP_PX = 7  # extent of a smoothed step, to both sides
# of a region's own depth: simulated second touches of 0.05 mm and more have 0.64 to 1.1
_PROMINENCE = 0.5
_RING_MM = (0.25, 0.8)  # inner and outer distance of the ring that a region is compared with
_FLANKS_MM = 0.8  # around a region: the flanks of a dent lie partly outside its contact
# Of the change: balls have at most 0.6 in one direction, other objects 0.83, spots of light from
# 0.94 on, over the touches of `benchmarks/real_depth.py`, `real_things.py` and `drift.py`.
_ONE_DIRECTION = 0.85
_BORDER_SHARE = 0.4  # of the deepest region: corners next to a real GelSlim's presses reach 0.36


def remove_false_contacts(
    touched: Mask,
    surface_mm: Floats,
    pixel_mm: float,
    border: Mask,
    changed: Mask,
    change_grey: Floats,
) -> Mask:
    """The contact `touched` (rows, cols) without false regions; the deepest region stays.

    A true region has flanks: some of it is steep, and not where the `changed` part of the image
    ends, since a surface raised by drift ends there in a step. It stands out from its surroundings.
    At the image `border`, beyond which nothing holds the surface, it has a good part of the deepest
    region's depth: light is least known in the corners. And its flanks face opposite LEDs, so that
    each colour of the image's `change_grey` (rows, cols, 3) rises on one and falls on the other; a
    spot of light changes all of it in one direction.
    """
    import cv2

    n, labels = cv2.connectedComponents(touched.astype(np.uint8), connectivity=8)
    if n <= 2:  # the background and one region
        return touched
    regions = np.asarray(labels, np.int32)
    depths = np.full(n, -np.inf, np.float32)
    np.maximum.at(depths, regions[touched], surface_mm[touched])
    depths = depths[1:]
    deepest = 1 + int(np.argmax(depths))
    slope = np.asarray(cv2.magnitude(*compute_slopes(surface_mm, pixel_mm)), np.float32)
    steepest = float(percentile(slope, 90.0, regions == deepest))
    steep = np.asarray(slope > min(_FLANK, _FLANK_OF_DEEPEST * steepest), np.bool_)
    steep &= _erode_inside(changed)
    keep = np.bincount(regions[touched & steep], minlength=n) > _FLANK_SHARE * np.bincount(
        regions.ravel(), minlength=n
    )
    cut = np.unique(regions[touched & border])
    keep[cut[depths[cut - 1] < _BORDER_SHARE * float(depths.max())]] = False
    keep[0] = keep[deepest] = False
    for k in np.flatnonzero(keep):
        region = np.equal(regions, k)
        keep[k] = _stands_out(region, touched, surface_mm, pixel_mm) and not _has_one_direction(
            change_grey, region, pixel_mm
        )
    keep[deepest] = True
    return np.asarray(keep[regions], np.bool_)


def _erode_inside(changed: Mask) -> Mask:
    """The pixels (rows, cols) farther from the end of `changed` than a smoothed step.

    The image border is no end.
    """
    import cv2

    kernel = np.ones((_STEP_PX, _STEP_PX), np.uint8)
    return np.asarray(cv2.erode(changed.astype(np.uint8), kernel, borderValue=1), np.bool_)


def _stands_out(region: Mask, touched: Mask, surface_mm: Floats, pixel_mm: float) -> bool:
    """Whether a region is deeper than the untouched ring around it by a good part of its depth."""
    import cv2

    near_px, far_px = (max(1, round(mm / pixel_mm)) for mm in _RING_MM)
    left, top, width, height = cv2.boundingRect(region.astype(np.uint8))
    around = far_px + near_px
    here = tuple(
        slice(max(0, first - around), first + n + around)
        for first, n in ((top, height), (left, width))
    )
    ring = _dilate(region[here], far_px) & ~_dilate(touched[here], near_px)
    if not ring.any():
        return True
    depth_mm = median(surface_mm, region)
    return bool(depth_mm - median(surface_mm[here], ring) > _PROMINENCE * depth_mm)


def _has_one_direction(change_grey: Floats, region: Mask, pixel_mm: float) -> bool:
    """Whether the colours of a region and its surroundings all rise or all fall."""
    seen = change_grey[_dilate(region, max(1, round(_FLANKS_MM / pixel_mm)))]
    return bool(np.abs(seen.sum(axis=0)).sum() > _ONE_DIRECTION * np.abs(seen).sum())


def _dilate(mask: Mask, by_px: int) -> Mask:
    import cv2

    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * by_px + 1, 2 * by_px + 1))
    return np.asarray(cv2.dilate(mask.astype(np.uint8), disc), np.bool_)
