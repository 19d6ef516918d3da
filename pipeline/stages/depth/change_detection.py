"""Where a gel's picture has changed: how much, and the part of it that is worked on."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pipeline.base.arrays import Floats, Image, Mask, freeze
from pipeline.stages.depth.contact import fill_holes
from pipeline.stages.depth.drift import compute_block_means

_BLOCK_PX = 8  # changes are looked for in blocks of this width
_GROWS_FROM = 0.35  # share of the no-touch limit down to which a touched region is followed outward
_DRIFT_FACTOR = 2.5  # times the picture's typical change, above which a block is part of a touch
_TYPICAL = 0.25  # quantile of the blocks' changes that stands for what the whole picture does: a touch may fill most
_TOGETHER = 1.2  # blocks over which a touch changes colours alike, and noise does not
_ABOVE_NOISE = 16.0  # times the noise of neighbours: a dithered film's untouched frames reach 15, its touches 16 to 100
_BLOCKS = 40  # along the longer side, at least, to tell noise by
_MARGIN_MM = 2.0  # beyond the last visible change: the gel relaxes to nothing within about this distance
_FADES = 0.5  # share of the margin over which the surface fades out


@dataclass(frozen=True, slots=True, kw_only=True)
class ImageWindow:
    """The part of the image that is worked on."""

    rows: slice
    cols: slice
    changed: Mask  # (rows, cols) of the window: where the surface is looked for
    blend_weight: Floats  # (rows, cols) of the surface that is kept: 1, and less toward the end of `moved`


def compute_largest_change(image: Image, reference: Image) -> float:
    """Largest mean absolute change of a block of 8 x 8 pixels, in grey levels; infinite if the image is black."""
    blocks = _block_change(image, reference)
    return float(blocks.max()) if int(image.max()) > 2 else math.inf


def _block_change(image: Image, reference: Image) -> Image:
    """Mean absolute change of every whole block (rows // 8, cols // 8, 3), rounded; the last few pixels are dropped."""
    import cv2

    from pipeline.stages.depth.change_detection_kernels import compute_block_change

    rows, cols = (n // _BLOCK_PX for n in image.shape[:2])
    if not (rows and cols):  # smaller than a block
        change = cv2.absdiff(image, reference)
        return np.asarray(cv2.resize(change, (max(1, cols), max(1, rows)), interpolation=cv2.INTER_AREA), np.uint8)
    out = np.empty((rows, cols, 3), np.uint8)
    of_rows = np.empty(3 * image.shape[1], np.uint16)
    compute_block_change(_flat(image), _flat(reference), _BLOCK_PX, of_rows, out)
    return out


def _flat(image: Image) -> Image:
    """Rows of numbers as the kernel takes them; read-only, as it is compiled anew for what can be written to."""
    return freeze(np.ascontiguousarray(image).reshape(image.shape[0], -1).view())


def detect_change(image: Image, reference: Image, no_touch_grey: float, pixel_mm: float) -> ImageWindow | None:
    """The box around everything that has changed, grown by the gel's relaxation; None where nothing has.

    Some block must have changed together with its neighbours by more than noise does.
    """
    import cv2

    blocks = _block_change(image, reference).max(axis=2).astype(np.float32)
    # A touch is not followed into what the whole picture does (drift of the light).
    low = max(_GROWS_FROM * no_touch_grey, _DRIFT_FACTOR * float(np.quantile(blocks, _TYPICAL)))
    if float(blocks.max()) < low:  # all of it has changed alike: a touch larger than the picture
        low = no_touch_grey
    above = _above_noise(image, reference, blocks.shape)
    n, regions = cv2.connectedComponents((blocks > low).astype(np.uint8), connectivity=8)
    strong = np.zeros(n, np.bool_)
    strong[np.unique(regions[blocks >= max(no_touch_grey, low)])] = True
    strong[0] = False
    if not (strong[regions] & (above >= 1.0)).any():
        return None
    # A flat face changes no colours, but it is not at rest: what a touch encloses belongs to it.
    whole = fill_holes(strong[regions])
    return grow_to_window(whole, image.shape[:2], pixel_mm)


def _above_noise(image: Image, reference: Image, shape: tuple[int, ...]) -> Floats:
    """How far the change of every block (rows // 8, cols // 8) and its neighbours lies above what noise makes, 1 = so.

    Dither and strong compression make grains of many pixels that no block averages out. Noise is told from how a block
    lies between its neighbours; all that is smooth, a touch and drift, does not count for it. A small picture is looked
    at in smaller blocks, between which a touch is still smooth; `shape` is that of the answer.
    """
    import cv2

    if min(shape) < 3:
        return np.full(shape, np.inf, np.float32)
    block_px = max(1, min(_BLOCK_PX, max(image.shape[:2]) // _BLOCKS))
    change = compute_block_means(image, block_px) - compute_block_means(reference, block_px)
    smooth = np.asarray(cv2.GaussianBlur(change, (0, 0), _TOGETHER), np.float32)
    bent = np.abs(smooth[:, 2:] - 2.0 * smooth[:, 1:-1] + smooth[:, :-2])
    noise = 1.48 * float(np.median(bent))  # a Gaussian's standard deviation
    above = np.abs(smooth).max(axis=2) / np.float32(max(_ABOVE_NOISE * noise, 1e-6))
    return above if above.shape == shape else np.asarray(cv2.resize(above, shape[::-1], interpolation=cv2.INTER_LINEAR))


def grow_to_window(touched: Mask, shape: tuple[int, ...], pixel_mm: float) -> ImageWindow:
    """The box around the blocks (rows // 8, cols // 8) that a touch has changed, and the margin around them.

    Blocks are looked at through their distances, so that the margin ends in a line and not in steps.
    """
    import cv2

    rows, cols = shape[:2]
    away = np.asarray(cv2.distanceTransform((~touched).astype(np.uint8), cv2.DIST_L2, 5), np.float32) * _BLOCK_PX
    tall, wide = touched.shape[0] * _BLOCK_PX, touched.shape[1] * _BLOCK_PX
    full = np.asarray(cv2.resize(away, (wide, tall), interpolation=cv2.INTER_LINEAR), np.float32)[:rows, :cols]
    full = np.pad(full, ((0, max(0, rows - tall)), (0, max(0, cols - wide))), "edge")
    left = np.clip((_MARGIN_MM / pixel_mm - full) * np.float32(pixel_mm / (_FADES * _MARGIN_MM)), 0.0, 1.0)
    moved = fill_holes(left > 0)
    left[moved & (left <= 0)] = 1.0
    r, c = np.flatnonzero(moved.any(axis=1)), np.flatnonzero(moved.any(axis=0))
    box = (_quick(int(r[0]) - _BLOCK_PX, int(r[-1]) + _BLOCK_PX + 1, rows),
           _quick(int(c[0]) - _BLOCK_PX, int(c[-1]) + _BLOCK_PX + 1, cols))  # fmt: skip
    return ImageWindow(rows=box[0], cols=box[1], changed=np.ascontiguousarray(moved[box]),
                  blend_weight=np.ascontiguousarray(left[box] * left[box] * (3 - 2 * left[box]), np.float32))  # fmt: skip


def _quick(low: int, high: int, n: int) -> slice:
    """The pixels `low` to `high` of `n`, and a few more, so that waves along them are quick to find."""
    from scipy import fft

    low, high = max(0, low), min(n, high)
    more = int(fft.next_fast_len(high - low, real=True) or 0) - (high - low)
    after = min(more, n - high)
    before = min(more - after, low)
    # Up to the border is another kind of end, which the touch does not have there: the last pixel stays outside.
    after -= after > 0 and high + after == n
    before -= before > 0 and low - before == 0
    return slice(low - before, high + after)
