"""A reference image with less noise: the median of a recording's first frames without contact.

The noise of one reference image enters every comparison; the median of a dozen has a third of it.
"""

from collections.abc import Iterable

import numpy as np

from pipeline.base.arrays import Floats, Image, freeze
from pipeline.recordings.block_means import compute_block_means

_MAX_FRAMES = 15
_MAX_PIXELS = 20_000_000  # of all frames together: reading more delays the opening of a recording
_MIN_FRAMES = 3  # including the reference; the median of two is their mean
_BLOCKS_ALONG = 16  # along the longer side: large enough that noise and dithering average out
_SAME_GREY = 1.5  # grey levels: change of a block's mean without contact
_NOISE_FACTOR = 3.5  # times the median change, the limit where it is larger than `_SAME_GREY`
_MAX_NOISE_GREY = 4.0  # grey levels: median change beyond which frames are not alike
_QUIET_SHARE = 0.995  # of the blocks must be alike; dirt on the lens may cover the rest


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
