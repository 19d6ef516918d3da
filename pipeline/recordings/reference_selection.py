"""A later frame as reference for a recording that begins with a touch.

A touch adds light and shade in one place, so that the image is less smooth there. Where two frames differ, the smoother
one has less contact. Drift and exposure change the smoothness of both alike.
"""

from collections.abc import Iterable

import numpy as np

from pipeline.base.arrays import Floats, Image
from pipeline.recordings.block_means import compute_block_means

_BLOCKS_ALONG = 24  # along the longer side: markers and noise average out, a touch does not
_DIFFERS_GREY = 8.0  # grey levels: change of a block's mean by a touch, not noise
_MIN_RELIEF_GREY = 1.0  # grey levels: least relief of a touch
_MAX_RELIEF_RATIO = 0.6  # of a reference to the first frame, where they differ


def select_reference_frame(first: Image, later: Iterable[tuple[int, Image]]) -> tuple[int, Image] | None:
    """(index, image) of the frame with least contact; None unless `first` clearly has more contact."""
    best: tuple[int, Image] | None = None
    first_blocks = best_blocks = compute_block_means(first, _BLOCKS_ALONG)
    for index, image in later:
        if image.shape != first.shape:
            continue
        blocks = compute_block_means(image, _BLOCKS_ALONG)
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
