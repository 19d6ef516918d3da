"""Frames of a recording to look at first: one with contact, and those that determine its
illumination.
"""

import contextlib
from collections.abc import Iterator

import numpy as np

from pipeline.core.arrays import Floats, Stored
from pipeline.core.digests import compute_cached_digest
from pipeline.core.errors import TouchError
from pipeline.core.frame_lists import spread_indices
from pipeline.core.values.frames import Stream, TactileFrame

_MOST_FRAMES = 24
_MOST_PIXELS = 40_000_000  # in all: reading more delays opening a recording
_MOST_TELLING = 4  # touches of one sensor instance: each takes as long as reading a frame
_BLOCKS_ALONG = 24  # along the longer side: large enough to average noise out


def find_contact_frame(stream: Stream) -> int:
    """Return the frame that differs most from its reference, among some spread evenly over the
    recording.

    0 where none differs, or where no frame has a reference. Unreadable frames are skipped.
    """
    best = 0
    most = 0.0
    for frame, change_of in compare_with_reference(stream):
        change = float(change_of.max())
        if change > most:
            best = frame.index
            most = change
    return best


def select_context_frames(stream: Stream) -> tuple[TactileFrame, ...]:
    """Return the frames of one sensor instance that determine its illumination best, the best
    first; none of a bubble.

    Of some frames spread evenly over the recording, those that change most of the image strongly
    and in other places than the frames before. They share one reference image, so that all are of
    one sensor instance and session.
    """
    found: list[tuple[TactileFrame, Floats]] = []
    for frame, change in compare_with_reference(stream):
        if frame.is_depth or frame.image.dtype != np.uint8:
            return ()
        if not found or compute_cached_digest(frame.reference) == compute_cached_digest(
            found[0][0].reference
        ):
            found.append((frame, change))
    chosen: list[TactileFrame] = []
    while found and len(chosen) < _MOST_TELLING:
        gains = [float(change.sum()) for _, change in found]
        best = int(np.argmax(gains))
        if gains[best] <= 0.0:
            break
        frame, most = found.pop(best)
        chosen.append(frame)
        found = [(other, np.maximum(change - most, 0.0)) for other, change in found]
    return tuple(chosen)


def compare_with_reference(stream: Stream) -> Iterator[tuple[TactileFrame, Floats]]:
    """Yield frames spread over the recording that have a reference of their shape, and how much
    they differ from it.

    The difference is of block means, in the frame's own unit; missing values count as unchanged.
    """
    reference = None
    at_rest = None
    for index in _spread(stream):
        try:
            frame = stream.frame(index)
        except TouchError:
            continue
        if frame.reference is None or frame.reference.shape != frame.image.shape:
            continue
        if at_rest is None or frame.reference is not reference:
            reference = frame.reference
            at_rest = _blocks(frame.reference)
        yield (
            frame,
            np.abs(np.nan_to_num(_blocks(frame.image) - at_rest, nan=0.0, posinf=0.0, neginf=0.0)),
        )


def _spread(stream: Stream) -> list[int]:
    if stream.n_frames < 2:
        return []
    rows = 320
    cols = 427
    with contextlib.suppress(TouchError):
        rows, cols = stream.frame(0).image.shape[:2]
    most = min(_MOST_FRAMES, max(3, _MOST_PIXELS // (rows * cols)))
    return spread_indices(stream.n_frames, most)


def _blocks(image: Stored) -> Floats:
    import cv2

    rows, cols = image.shape[:2]
    size = tuple(max(1, round(_BLOCKS_ALONG * n / max(rows, cols))) for n in (cols, rows))
    return np.asarray(
        cv2.resize(np.asarray(image, np.float32), size, interpolation=cv2.INTER_AREA), np.float32
    )
