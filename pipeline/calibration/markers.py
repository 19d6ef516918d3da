"""Printed markers of a gel: their detection in an image, and the colour change without them."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Floats, Mask, freeze
from pipeline.base.memo import Memo
from pipeline.engine.digests import compute_cached_digest
from pipeline.sensors.spec import Markers

_DARKER = 0.12  # a marker is darker than its surroundings by this share of their brightness
_HALO_PX = 2  # lens blur around a dot
_DISC_MAX_PX = 41  # of the disc of the closing
_VISIBLE_SHARE_MIN = 0.02  # of a mean: with fewer visible pixels it is void
_HIDDEN_SHARE = 0.25  # share of a pixel from which it counts as hidden
_FULL_SIZE_SIGMA_PX = 1.6  # wider Gaussians are computed on fewer pixels


def detect_markers(image: NDArray[Any], markers: Markers, pixel_mm: float) -> Mask:
    """Mask (rows, cols) of dark dots up to the size of the sensor's markers, with their blurred rim.

    Large dots are detected on a smaller image: closing by a disc costs its area for every pixel.
    """
    import cv2

    width = 2 * math.ceil(2.2 * (markers.radius_mm + markers.doubling_mm / 2) / pixel_mm) + 1
    if width > _DISC_MAX_PX:
        by = math.ceil(width / _DISC_MAX_PX)
        rows, cols = image.shape[:2]
        small = cv2.resize(image, (max(1, cols // by), max(1, rows // by)), interpolation=cv2.INTER_AREA)
        found = detect_markers(small, markers, pixel_mm * cols / small.shape[1])
        wide = cv2.resize(found.astype(np.float32), (cols, rows), interpolation=cv2.INTER_LINEAR)
        return np.asarray(wide > _HIDDEN_SHARE, np.bool_)
    red, green, blue = cv2.split(image)
    brightest = np.asarray(cv2.max(cv2.max(red, green), blue))
    dot = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (width, width))
    around = cv2.morphologyEx(brightest, cv2.MORPH_CLOSE, dot)
    dark = (around.astype(np.float32) - brightest) > _DARKER * around + 4.0
    rim = np.ones((2 * _HALO_PX + 1, 2 * _HALO_PX + 1), np.uint8)
    return np.asarray(cv2.dilate(dark.astype(np.uint8), rim), np.bool_)


def inpaint(change: Floats, hidden: Mask, sigma_px: float) -> Floats:
    """`change` (rows, cols, channels) with hidden pixels replaced by a Gaussian mean of the visible ones around.

    A wider mean takes over where a narrower one has no visible pixel.
    """
    channels = change.shape[2]
    out = np.array(change)
    seen = (~hidden).astype(np.float32)
    shown = change * seen[..., None]
    filled, todo = out.reshape(-1, channels), np.flatnonzero(hidden)
    for reach in (sigma_px, 3 * sigma_px, 9 * sigma_px):
        weight = _blur(seen, reach).ravel()[todo]
        ready = weight > _VISIBLE_SHARE_MIN
        at = todo[ready]
        mean = _blur(shown, reach).reshape(-1, channels)
        filled[at] = mean[at] / weight[ready][:, None]
        todo = todo[~ready]
        if not len(todo):
            break
    filled[todo] = 0.0
    return out


def _blur(image: Floats, sigma_px: float) -> Floats:
    import cv2

    by = int(sigma_px / _FULL_SIZE_SIGMA_PX * 2.0)
    if by <= 1 or min(image.shape[:2]) < 2 * by:
        return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma_px), np.float32)
    rows, cols = image.shape[:2]
    small = cv2.resize(image, (-(-cols // by), -(-rows // by)), interpolation=cv2.INTER_AREA)
    blurred = cv2.GaussianBlur(small, (0, 0), sigma_px / by)
    return np.asarray(cv2.resize(blurred, (cols, rows), interpolation=cv2.INTER_LINEAR), np.float32)


def remove_printed_markers(still: NDArray[Any], markers: Markers, pixel_mm: float) -> tuple[Mask, Floats]:
    """(mask of the markers of a reference image, the image (rows, cols, 3) without them).

    Cached, since the same reference is used with every touch.
    """
    return _inpainted_references.get_or_make(
        (compute_cached_digest(still), markers, pixel_mm), lambda: _inpaint_reference(still, markers, pixel_mm)
    )


def inpaint_markers(change: Floats, hidden: Mask, markers: Markers, pixel_mm: float) -> Floats:
    """`change` (rows, cols, 3) with the pixels inpainted that markers hide in either image."""
    return inpaint(change, hidden, _compute_sigma_px(markers, pixel_mm))


_inpainted_references: Memo[tuple[str, Markers, float], tuple[Mask, Floats]] = Memo(4, most_bytes=4 * 1024 * 1024)


def _inpaint_reference(still: NDArray[Any], markers: Markers, pixel_mm: float) -> tuple[Mask, Floats]:
    printed = detect_markers(still, markers, pixel_mm)
    return freeze(printed), freeze(inpaint(still.astype(np.float32), printed, _compute_sigma_px(markers, pixel_mm)))


def _compute_sigma_px(markers: Markers, pixel_mm: float) -> float:
    return max(1.0, markers.radius_mm / pixel_mm / 2)
