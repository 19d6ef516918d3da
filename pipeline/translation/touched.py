"""Which frame of a recording to look at first: one on which something touches."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Floats
from pipeline.base.errors import TouchError
from pipeline.values.frames import Stream

_MOST_FRAMES = 24
_MOST_PIXELS = 40_000_000  # in all: reading more takes longer than a person waits for a recording to open
_BLOCKS_ALONG = 24  # the longer side: wide enough that noise averages out


def touched_frame(stream: Stream) -> int:
    """The frame that has changed most from its untouched reading, of some spread evenly over the recording.

    0 where none has, or where no frame brings an untouched reading. Frames that cannot be read are passed over.
    """
    best, most = 0, 0.0
    for index in _spread(stream):
        try:
            frame = stream.frame(index)
        except TouchError:
            continue
        if frame.reference is None or frame.reference.shape != frame.image.shape:
            continue
        change = _change(frame.image, frame.reference)
        if change > most:
            best, most = index, change
    return best


def _spread(stream: Stream) -> list[int]:
    if stream.n_frames < 2:
        return []
    try:
        rows, cols = stream.frame(0).image.shape[:2]
    except TouchError:
        rows, cols = 320, 427
    count = min(_MOST_FRAMES, stream.n_frames, max(3, _MOST_PIXELS // (rows * cols)))
    return [round(i) for i in np.linspace(0, stream.n_frames - 1, count)]


def _change(image: NDArray[np.generic], reference: NDArray[np.generic]) -> float:
    """Largest change of a block's mean, in the reading's own unit; what is no reading has not changed."""
    gap = np.nan_to_num(_blocks(image) - _blocks(reference), nan=0.0, posinf=0.0, neginf=0.0)
    return float(np.abs(gap).max())


def _blocks(image: NDArray[np.generic]) -> Floats:
    import cv2

    rows, cols = image.shape[:2]
    size = tuple(max(1, round(_BLOCKS_ALONG * n / max(rows, cols))) for n in (cols, rows))
    return np.asarray(cv2.resize(np.asarray(image, np.float32), size, interpolation=cv2.INTER_AREA), np.float32)
