"""Printed markers of a gel: where they are in a picture, and what the colour change would be without them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Floats, Mask
from pipeline.sensors.spec import Markers

_DARKER = 0.12  # share of the local brightness by which a marker lies below its surroundings
_HALO_PX = 2  # lens blur around a dot


def marker_mask(picture: NDArray[Any], markers: Markers, pixel_mm: float) -> Mask:
    """Pixels (rows, cols) of dark dots up to the size of the sensor's markers, with their blurred rim."""
    import cv2

    brightest = picture.max(axis=2)
    width = 2 * math.ceil(2.2 * (markers.radius_mm + markers.twin_mm / 2) / pixel_mm) + 1
    dot = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (width, width))
    around = cv2.morphologyEx(brightest, cv2.MORPH_CLOSE, dot)
    dark = (around.astype(np.float32) - brightest) > _DARKER * around + 4.0
    rim = np.ones((2 * _HALO_PX + 1, 2 * _HALO_PX + 1), np.uint8)
    return np.asarray(cv2.dilate(dark.astype(np.uint8), rim), np.bool_)


def inpainted(change: Floats, hidden: Mask, reach_px: float) -> Floats:
    """`change` (rows, cols, channels) with hidden pixels replaced by a Gaussian mean of the visible ones around.

    Wider means take over where a narrower one sees nothing.
    """
    import cv2

    out = change.copy()
    seen = (~hidden).astype(np.float32)
    todo = hidden
    for reach in (reach_px, 3 * reach_px, 9 * reach_px):
        weight = np.asarray(cv2.GaussianBlur(seen, (0, 0), reach), np.float32)
        ready = todo & (weight > 0.02)
        mean = np.asarray(cv2.GaussianBlur(change * seen[..., None], (0, 0), reach), np.float32)
        out[ready] = mean[ready] / weight[ready][:, None]
        todo = todo & ~ready
        if not todo.any():
            break
    out[todo] = 0.0
    return out
