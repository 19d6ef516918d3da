"""A steadier picture of the untouched sensor: the median of a recording's first frames, as long as none is touched.

One picture carries its camera's noise into every comparison; the median of a dozen has a third of it.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from pipeline.base.arrays import Floats, Image, freeze

_MOST_FRAMES = 15
_MOST_PIXELS = 20_000_000  # in all: reading more takes longer than a person waits for a recording to open
_FEWEST = 3  # with the reference itself; the median of two is their mean
_BLOCKS_ALONG = 16  # the longer side: wide enough that noise and dithering average out
_SAME_GREY = 1.5  # of a block's mean
_NOISES = 3.5  # times the usual change of a block's mean, where there is more noise
_MOST_NOISE_GREY = 4.0
_QUIET_SHARE = 0.995  # of the blocks: a fly may sit on the lens


def denoise_reference(reference: Image, frames: Iterable[Image]) -> tuple[Image, int]:
    """(the median (rows, cols, 3) of the reference and the first frames without a touch, how many frames went in).

    `frames` are asked for in turn and no further than the first touched one; with too few of them the reference
    comes back as it is, and 0.
    """
    most = min(_MOST_FRAMES, _MOST_PIXELS // max(1, reference.shape[0] * reference.shape[1]))
    still, kept = _blocks(reference), [reference]
    for image in frames:
        if len(kept) > most or image.shape != reference.shape or not _same(_blocks(image), still):
            break
        kept.append(image)
    if len(kept) < _FEWEST:
        return reference, 0
    return freeze(np.median(np.stack(kept), axis=0).round().astype(np.uint8)), len(kept) - 1


def _same(now: Floats, still: Floats) -> bool:
    change = np.abs(now - still).max(axis=2)
    limit = max(_SAME_GREY, _NOISES * float(np.median(change)))
    return bool(np.quantile(change, _QUIET_SHARE) <= limit and float(np.median(change)) <= _MOST_NOISE_GREY)


def _blocks(image: Image) -> Floats:
    import cv2

    rows, cols = image.shape[:2]
    size = tuple(max(1, round(_BLOCKS_ALONG * n / max(rows, cols))) for n in (cols, rows))
    return np.asarray(cv2.resize(image.astype(np.float32), size, interpolation=cv2.INTER_AREA), np.float32)
