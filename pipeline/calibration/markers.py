"""Printed markers of a gel: their detection and motion, and the colour change without them."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.core.arrays import Doubles, Floats, Mask, freeze
from pipeline.core.derived import derive_once
from pipeline.sensors.spec import Markers

_DARKER = 0.12  # a marker is darker than its surroundings by this share of their brightness
_HALO_PX = 2  # lens blur around a dot
_DISC_MAX_PX = 41  # of the disc of the closing
_VISIBLE_SHARE_MIN = 0.02  # of a mean: with fewer visible pixels it is void
_HIDDEN_SHARE = 0.25  # share of a pixel from which it counts as hidden
_DARK_GREY = 50  # of 255, from which a pixel belongs to a dot
_BLACK = 8.0  # grey: surroundings as dark as this hide dots
_WHOLE_SHARE = 0.3  # of the median area of dots: smaller ones are cut by the border, or noise
_WINDOW_PITCHES = 0.7  # side of the optical flow's window: one dot
_RETURN_PX = 0.5
_FULL_SIZE_SIGMA_PX = 1.6  # wider Gaussians are computed on fewer pixels


def detect_markers(image: NDArray[Any], markers: Markers, pixel_mm: float) -> Mask:
    """Mask (rows, cols) of dark dots up to the size of the sensor's markers, with their blurred
    rim.

    Large dots are detected on a smaller image: closing by a disc costs its area for every pixel.
    """
    import cv2

    width = _compute_dot_width_px(markers, pixel_mm)
    if width > _DISC_MAX_PX:
        by = math.ceil(width / _DISC_MAX_PX)
        rows, cols = image.shape[:2]
        small = cv2.resize(
            image, (max(1, cols // by), max(1, rows // by)), interpolation=cv2.INTER_AREA
        )
        found = detect_markers(small, markers, pixel_mm * cols / small.shape[1])
        wide = cv2.resize(found.astype(np.float32), (cols, rows), interpolation=cv2.INTER_LINEAR)
        return np.asarray(wide > _HIDDEN_SHARE, np.bool_)
    brightest, around = _compare_with_surroundings(image, width)
    dark = (around.astype(np.float32) - brightest) > _DARKER * around + 4.0
    rim = np.ones((2 * _HALO_PX + 1, 2 * _HALO_PX + 1), np.uint8)
    return np.asarray(cv2.dilate(dark.astype(np.uint8), rim), np.bool_)


def track_markers(
    reference: NDArray[Any], image: NDArray[Any], markers: Markers, pixel_mm: float
) -> tuple[Doubles, Doubles]:
    """(n, 2) places (column, row) in pixels of the markers in a reference image, and those in
    another image.

    Optical flow of the darkness of the dots, which does not change with the light; markers that it
    does not bring back to where they were are left out.
    """
    import cv2

    width = _compute_dot_width_px(markers, pixel_mm)
    before, after = (_compute_darkness(a, width) for a in (reference, image))
    count, _, boxes, centres = cv2.connectedComponentsWithStats(
        (before > _DARK_GREY).astype(np.uint8), connectivity=8
    )
    area = boxes[1:count, cv2.CC_STAT_AREA]
    whole = area > _WHOLE_SHARE * np.median(area) if len(area) else np.zeros(0, np.bool_)
    start = centres[1:count][whole].astype(np.float32)
    if not len(start):
        return np.zeros((0, 2)), np.zeros((0, 2))
    side = int(_WINDOW_PITCHES * markers.pitch_mm / pixel_mm) | 1
    end, found = _compute_flow(before, after, start, side)
    back, returned = _compute_flow(after, before, end, side)
    kept = found & returned & (np.hypot(*(back - start).T) < _RETURN_PX)
    return start[kept].astype(np.float64), end[kept].astype(np.float64)


def _compute_flow(
    before: NDArray[np.uint8], after: NDArray[np.uint8], places: Floats, side_px: int
) -> tuple[Floats, Mask]:
    """Where the `places` (n, 2) of one image are in another, and which were found."""
    import cv2

    stop = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 40, 0.005)
    moved, found, _ = cv2.calcOpticalFlowPyrLK(
        before, after, places, places.copy(), winSize=(side_px, side_px), maxLevel=3, criteria=stop
    )
    return np.asarray(moved, np.float32), np.asarray(found[:, 0] > 0, np.bool_)


def _compute_darkness(image: NDArray[Any], width: int) -> NDArray[np.uint8]:
    """How much darker a pixel is than its surroundings, 0 to 255 = black."""
    import cv2

    brightest, around = _compare_with_surroundings(image, width)
    smooth = cv2.GaussianBlur(around.astype(np.float32), (0, 0), width / 4)
    return np.asarray(
        255 * np.clip(1 - brightest / np.maximum(np.asarray(smooth), _BLACK), 0, 1), np.uint8
    )


def _compare_with_surroundings(
    image: NDArray[Any], width: int
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """(rows, cols) brightest channel, and the same without dark dots of up to `width` pixels."""
    import cv2

    red, green, blue = cv2.split(image)
    brightest = np.asarray(cv2.max(cv2.max(red, green), blue), np.uint8)
    dot = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (width, width))
    return brightest, np.asarray(cv2.morphologyEx(brightest, cv2.MORPH_CLOSE, dot), np.uint8)


def _compute_dot_width_px(markers: Markers, pixel_mm: float) -> int:
    return 2 * math.ceil(2.2 * (markers.radius_mm + markers.doubling_mm / 2) / pixel_mm) + 1


def inpaint(change: Floats, hidden: Mask, sigma_px: float) -> Floats:
    """`change` (rows, cols, channels) with hidden pixels replaced by a Gaussian mean of the visible
    ones around.

    A wider mean takes over where a narrower one has no visible pixel.
    """
    import cv2

    seen = (~hidden).astype(np.float32)
    shown = np.asarray(cv2.multiply(change, cv2.merge([seen] * change.shape[2])), np.float32)
    out = shown.copy()
    left = np.array(hidden)
    for reach in (sigma_px, 3 * sigma_px, 9 * sigma_px):
        if not left.any():
            break
        weight = _blur(seen, reach)
        ready = left & (weight > _VISIBLE_SHARE_MIN)
        out[ready] = _blur(shown, reach)[ready] / weight[ready][:, None]
        left &= ~ready
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


@derive_once
def remove_printed_markers(
    still: NDArray[Any], markers: Markers, pixel_mm: float
) -> tuple[Mask, Floats]:
    """(mask of the markers of a reference image, the image (rows, cols, 3) without them).

    Computed once, since the same reference is used with every touch.
    """
    printed = detect_markers(still, markers, pixel_mm)
    return freeze(printed), freeze(
        inpaint(still.astype(np.float32), printed, _compute_sigma_px(markers, pixel_mm))
    )


def inpaint_markers(change: Floats, hidden: Mask, markers: Markers, pixel_mm: float) -> Floats:
    """`change` (rows, cols, 3) with the pixels inpainted that markers hide in either image."""
    return inpaint(change, hidden, _compute_sigma_px(markers, pixel_mm))


def _compute_sigma_px(markers: Markers, pixel_mm: float) -> float:
    return max(1.0, markers.radius_mm / pixel_mm / 2)
