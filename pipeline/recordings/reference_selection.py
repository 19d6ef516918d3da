"""Whether a recording begins with a touch, and which later frame shows the sensor as it is when nothing touches.

A touch adds light and shade to the untouched picture, in one place: there the picture is less smooth. Where two frames
differ, the smoother one is the less touched. Drift and another exposure change as much of both.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from pipeline.base.arrays import Floats, Image

_BLOCKS_ALONG = 24  # the longer side: markers and noise average out, a touch does not
_DIFFERS_GREY = 8.0  # of a block's mean: a touch, not noise
_LEAST_GREY = 1.0  # by which blocks of a touch depart from their neighbours, at least
_SMOOTHER = 0.6  # at most as much light and shade as the first frame has, where they differ


def select_reference_frame(first: Image, later: Iterable[tuple[int, Image]]) -> tuple[int, Image] | None:
    """The (index, picture) of the frame that is touched least, where `first` is clearly touched more; else None."""
    found: tuple[int, Image] | None = None
    begins = now = _blocks(first)
    for index, image in later:
        if image.shape != first.shape:
            continue
        other = _blocks(image)
        if _share(other, begins) <= _SMOOTHER and (found is None or _share(other, now) < 1.0):
            found, now = (index, image), other
    return found


def _share(other: Floats, one: Floats) -> float:
    """How much light and shade a picture's blocks have beside another's, where the two differ; infinite elsewhere."""
    differs = np.abs(other - one).max(axis=2) > _DIFFERS_GREY
    if not differs.any():
        return np.inf
    here, there = (float(_relief(blocks)[differs].mean()) for blocks in (other, one))
    return here / there if there > _LEAST_GREY else np.inf


def _relief(blocks: Floats) -> Floats:
    """By how much each block (rows, cols) departs from its neighbours' mean, in grey levels."""
    import cv2

    return np.abs(np.asarray(cv2.Laplacian(blocks, cv2.CV_32F, borderType=cv2.BORDER_REPLICATE))).max(axis=2)


def _blocks(image: Image) -> Floats:
    import cv2

    rows, cols = image.shape[:2]
    size = tuple(max(1, round(_BLOCKS_ALONG * n / max(rows, cols))) for n in (cols, rows))
    return np.asarray(cv2.resize(image.astype(np.float32), size, interpolation=cv2.INTER_AREA), np.float32)
