"""Which regions of a surface something presses into, and which drifting light leaves beside a touch."""

from __future__ import annotations

import numpy as np

from pipeline.base.arrays import Floats, Mask
from pipeline.base.ranks import percentile
from pipeline.physics.slopes import slopes

_FLANK, _FLANK_SHARE = 0.12, 0.1  # mm/mm, and of a region's pixels
_FLANK_OF_DEEPEST = 0.7  # of the steepest tenth of the deepest region, where a light touch has nothing steeper
_BORDER_SHARE = 0.4  # of the deepest region: corners beside a real GelSlim's presses come out up to 0.36


def pressed_in(touched: Mask, surface_mm: Floats, pixel_mm: float, border: Mask | None = None) -> Mask:
    """`touched` without the broad, shallow regions that drifting light leaves beside a touch; the deepest one stays.

    What presses has flanks: some of its region is steep. On the image's `border`, beyond which nothing holds the
    surface, it must be a good part as deep as the deepest too: the corners of a picture are where light is least known.
    """
    import cv2

    n, found = cv2.connectedComponents(touched.astype(np.uint8), connectivity=8)
    if n <= 2:  # the background and one region
        return touched
    regions = np.asarray(found, np.int32)
    depths = np.full(n, -np.inf, np.float32)
    np.maximum.at(depths, regions[touched], surface_mm[touched])
    depths = depths[1:]
    slope = np.asarray(cv2.magnitude(*slopes(surface_mm, pixel_mm)), np.float32)
    steepest = float(percentile(slope, 90.0, regions == 1 + int(np.argmax(depths))))
    steep = slope > min(_FLANK, _FLANK_OF_DEEPEST * steepest)
    keep = np.bincount(regions[touched & steep], minlength=n) > _FLANK_SHARE * np.bincount(regions.ravel(), minlength=n)
    if border is not None:
        cut = np.unique(regions[touched & border])
        keep[cut[depths[cut - 1] < _BORDER_SHARE * float(depths.max())]] = False
    keep[1 + int(np.argmax(depths))] = True
    keep[0] = False
    return np.asarray(keep[regions], np.bool_)
