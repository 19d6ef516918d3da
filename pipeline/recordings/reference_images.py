"""Images of a gel without contact: with less noise, or replaced by a later frame.

The noise of one reference image enters every comparison; the median of a dozen has a third of it.
"""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Floats, Image, freeze

_MAX_FRAMES = 15
_MAX_PIXELS = 20_000_000  # of all frames together: reading more delays the opening of a recording
_MIN_FRAMES = 3  # including the reference; the median of two is their mean
_BLOCKS_ALONG = 16  # along the longer side: large enough that noise and dithering average out
_SAME_GREY = 1.5  # grey levels: change of a block's mean without contact
_NOISE_FACTOR = 3.5  # times the median change, the limit where it is larger than `_SAME_GREY`
_MAX_NOISE_GREY = 4.0  # grey levels: median change beyond which frames are not alike
_QUIET_SHARE = 0.995  # of the blocks must be alike; dirt on the lens may cover the rest
_TOUCH_BLOCKS = 24  # along the longer side: markers and noise average out, a touch does not
_DIFFERS_GREY = 8.0  # grey levels: change of a block's mean by a touch, not noise
_MIN_RELIEF_GREY = 1.0  # grey levels: least relief of a touch
_MAX_RELIEF_RATIO = 0.6  # of a reference to the first frame, where they differ


def compute_block_means(image: NDArray[np.generic], n_along: int) -> Floats:
    """Means (block rows, block cols, channels) with `n_along` blocks along the longer side; NaN counts as 0.

    `image` is (rows, cols) or (rows, cols, channels).
    """
    import cv2

    rows, cols = image.shape[:2]
    size = tuple(max(1, round(n_along * n / max(rows, cols))) for n in (cols, rows))
    values = np.nan_to_num(np.asarray(image, np.float32))
    means = np.asarray(cv2.resize(values, size, interpolation=cv2.INTER_AREA), np.float32)
    return means[..., None] if means.ndim == 2 else means


def denoise_reference(reference: Image, frames: Iterable[Image]) -> tuple[Image, int]:
    """(median (rows, cols, 3) of the reference and the first frames without contact, number of these frames).

    `frames` is read up to the first frame with contact; with too few frames the result is (`reference`, 0).
    """
    n_max = min(_MAX_FRAMES, _MAX_PIXELS // max(1, reference.shape[0] * reference.shape[1]))
    reference_blocks, stack = compute_block_means(reference, _BLOCKS_ALONG), [reference]
    for image in frames:
        if len(stack) > n_max or image.shape != reference.shape or not _are_alike(image, reference_blocks):
            break
        stack.append(image)
    if len(stack) < _MIN_FRAMES:
        return reference, 0
    return freeze(np.median(np.stack(stack), axis=0).round().astype(np.uint8)), len(stack) - 1


def _are_alike(image: Image, reference_blocks: Floats) -> bool:
    change = np.abs(compute_block_means(image, _BLOCKS_ALONG) - reference_blocks).max(axis=2)
    limit = max(_SAME_GREY, _NOISE_FACTOR * float(np.median(change)))
    return bool(np.quantile(change, _QUIET_SHARE) <= limit and float(np.median(change)) <= _MAX_NOISE_GREY)


def select_reference_frame(first: Image, later: Iterable[tuple[int, Image]]) -> tuple[int, Image] | None:
    """(index, image) of the frame with least contact; None unless `first` clearly has more contact.

    A touch adds light and shade in one place, so that the image is less smooth there. Where two frames differ, the
    smoother one has less contact. Drift and exposure change the smoothness of both alike.
    """
    best: tuple[int, Image] | None = None
    first_blocks = best_blocks = compute_block_means(first, _TOUCH_BLOCKS)
    for index, image in later:
        if image.shape != first.shape:
            continue
        blocks = compute_block_means(image, _TOUCH_BLOCKS)
        is_smooth = _compute_relief_ratio(blocks, first_blocks) <= _MAX_RELIEF_RATIO
        if is_smooth and (best is None or _compute_relief_ratio(blocks, best_blocks) < 1.0):
            best, best_blocks = (index, image), blocks
    return best


def _compute_relief_ratio(other: Floats, one: Floats) -> float:
    """Relief of the blocks `other` over that of `one`, where the two differ; infinite if they do not."""
    differs = np.abs(other - one).max(axis=2) > _DIFFERS_GREY
    if not differs.any():
        return np.inf
    here, there = (float(_compute_relief(blocks)[differs].mean()) for blocks in (other, one))
    return here / there if there > _MIN_RELIEF_GREY else np.inf


def _compute_relief(blocks: Floats) -> Floats:
    """Difference of each block (rows, cols) from the mean of its neighbours, in grey levels."""
    import cv2

    return np.abs(np.asarray(cv2.Laplacian(blocks, cv2.CV_32F, borderType=cv2.BORDER_REPLICATE))).max(axis=2)
