"""Printed markers of a gel: where they are in a picture, and what the colour change would be without them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Floats, Mask, freeze
from pipeline.base.memo import Memo
from pipeline.engine.digests import compute_cached_digest
from pipeline.sensors.spec import Markers

_DARKER = 0.12  # share of the local brightness by which a marker lies below its surroundings
_HALO_PX = 2  # lens blur around a dot
_WIDEST_PX = 41  # of the disc that closes dots
_SEEN_SHARE = 0.02  # of a mean: fewer visible pixels tell nothing
_PART_HIDDEN = 0.25  # share of a pixel
_SHARP_PX = 1.6  # Gaussian means wider than this are taken on fewer pixels


def detect_markers(picture: NDArray[Any], markers: Markers, pixel_mm: float) -> Mask:
    """Pixels (rows, cols) of dark dots up to the size of the sensor's markers, with their blurred rim.

    Where a dot has many pixels it is looked for on fewer: closing by a disc costs its area for every pixel.
    """
    import cv2

    width = 2 * math.ceil(2.2 * (markers.radius_mm + markers.doubling_mm / 2) / pixel_mm) + 1
    if width > _WIDEST_PX:
        by = math.ceil(width / _WIDEST_PX)
        rows, cols = picture.shape[:2]
        small = cv2.resize(picture, (max(1, cols // by), max(1, rows // by)), interpolation=cv2.INTER_AREA)
        found = detect_markers(small, markers, pixel_mm * cols / small.shape[1])
        wide = cv2.resize(found.astype(np.float32), (cols, rows), interpolation=cv2.INTER_LINEAR)
        return np.asarray(wide > _PART_HIDDEN, np.bool_)
    red, green, blue = cv2.split(picture)
    brightest = np.asarray(cv2.max(cv2.max(red, green), blue))
    dot = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (width, width))
    around = cv2.morphologyEx(brightest, cv2.MORPH_CLOSE, dot)
    dark = (around.astype(np.float32) - brightest) > _DARKER * around + 4.0
    rim = np.ones((2 * _HALO_PX + 1, 2 * _HALO_PX + 1), np.uint8)
    return np.asarray(cv2.dilate(dark.astype(np.uint8), rim), np.bool_)


def inpaint(change: Floats, hidden: Mask, reach_px: float) -> Floats:
    """`change` (rows, cols, channels) with hidden pixels replaced by a Gaussian mean of the visible ones around.

    Wider means take over where a narrower one sees nothing.
    """
    channels = change.shape[2]
    out = np.array(change)
    seen = (~hidden).astype(np.float32)
    shown = change * seen[..., None]
    filled, todo = out.reshape(-1, channels), np.flatnonzero(hidden)
    for reach in (reach_px, 3 * reach_px, 9 * reach_px):
        weight = _mean(seen, reach).ravel()[todo]
        ready = weight > _SEEN_SHARE
        at = todo[ready]
        mean = _mean(shown, reach).reshape(-1, channels)
        filled[at] = mean[at] / weight[ready][:, None]
        todo = todo[~ready]
        if not len(todo):
            break
    filled[todo] = 0.0
    return out


def _mean(image: Floats, reach_px: float) -> Floats:
    """The Gaussian mean around every pixel."""
    import cv2

    by = int(reach_px / _SHARP_PX * 2.0)
    if by <= 1 or min(image.shape[:2]) < 2 * by:
        return np.asarray(cv2.GaussianBlur(image, (0, 0), reach_px), np.float32)
    rows, cols = image.shape[:2]
    small = cv2.resize(image, (-(-cols // by), -(-rows // by)), interpolation=cv2.INTER_AREA)
    blurred = cv2.GaussianBlur(small, (0, 0), reach_px / by)
    return np.asarray(cv2.resize(blurred, (cols, rows), interpolation=cv2.INTER_LINEAR), np.float32)


def remove_printed_markers(still: NDArray[Any], markers: Markers, pixel_mm: float) -> tuple[Mask, Floats]:
    """(where the markers of an untouched picture are, the picture (rows, cols, 3) without them).

    Both are kept: the same untouched picture is read with every touch.
    """
    return _unprinted.get_or_make(
        (compute_cached_digest(still), markers, pixel_mm), lambda: _without(still, markers, pixel_mm)
    )


def inpaint_markers(change: Floats, hidden: Mask, markers: Markers, pixel_mm: float) -> Floats:
    """`change` (rows, cols, 3) as it would be without the markers, which hide some pixels of either picture."""
    return inpaint(change, hidden, _reach_px(markers, pixel_mm))


_unprinted: Memo[tuple[str, Markers, float], tuple[Mask, Floats]] = Memo(4, most_bytes=4 * 1024 * 1024)


def _without(still: NDArray[Any], markers: Markers, pixel_mm: float) -> tuple[Mask, Floats]:
    printed = detect_markers(still, markers, pixel_mm)
    return freeze(printed), freeze(inpaint(still.astype(np.float32), printed, _reach_px(markers, pixel_mm)))


def _reach_px(markers: Markers, pixel_mm: float) -> float:
    return max(1.0, markers.radius_mm / pixel_mm / 2)
