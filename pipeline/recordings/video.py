"""A video file of one sensor, sought frame by frame."""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base.arrays import Image, freeze
from pipeline.base.errors import FileProblem
from pipeline.base.stage_warnings import StageWarning
from pipeline.base.text import is_text
from pipeline.recordings import difference_images, image_files
from pipeline.recordings.gel_images import make_gel_converter
from pipeline.recordings.index_check import with_index_check
from pipeline.recordings.reference_denoising import denoise_reference
from pipeline.recordings.reference_selection import select_reference_frame
from pipeline.values.frames import Recording, Stream, TactileFrame

_MOST_LOOKED_AT = 16  # frames, for one that is not touched: seeking in a long video takes a while
_MOST_FRAMES = 10_000_000  # an hour at 2,700 Hz
VIDEO_SUFFIXES = frozenset({".mp4", ".avi", ".mov", ".mkv", ".webm", ".m4v"})


def read(path: Path, *, sensor: str = "", reference: Path | None = None) -> Recording:
    """The video as one stream of RGB frames; without `reference` its first frames are taken as untouched, and noted.

    Where the video clearly begins with a touch, a later frame is taken in their place, and doubted.
    Raises FileProblem when the video or its first frame cannot be decoded.
    """
    video = _Video(path)
    first = video.frame(0)
    changes = reference is None and difference_images.estimate_no_change_grey(first) is not None
    untouched = image_files.read_rgb(reference) if reference is not None else None if changes else first
    if untouched is not None and untouched.shape != first.shape:
        video.close()
        assert reference is not None
        raise FileProblem(f"the reference has shape {untouched.shape}, the video {first.shape}", reference)
    begins, steadier = 0, 0
    if reference is None and untouched is not None:
        begins, untouched = select_reference_frame(untouched, _spread(video)) or (0, untouched)
        untouched, steadier = denoise_reference(untouched, _following(video, begins))
    made = make_gel_converter(sensor, (first.shape[0], first.shape[1]), untouched, lambda: first)
    about = () if changes else (_about(reference, begins, steadier),)

    def frame(index: int) -> TactileFrame:
        return TactileFrame(sensor=made.sensor, image=made.convert_image(video.frame(index)), reference=made.reference,
                            index=index, time_s=index / video.rate_hz, origin=f"{path} [frame {index}]")  # fmt: skip

    stream = Stream(name=made.sensor or "video", sensor=made.sensor, n_frames=video.n_frames,
                    frame=with_index_check(frame, video.n_frames, path))  # fmt: skip
    notes = (*made.notes, *about, "times are counted from the frame rate that the file states")
    return Recording(path=path, format="video", streams=(stream,), close=video.close, notes=notes)


def _about(reference: Path | None, begins: int, steadier: int) -> str:
    if reference is not None:
        return f"{reference.name} shows the untouched sensor"
    if begins:
        which = f"frame {begins}" if not steadier else f"the median of frames {begins} to {begins + steadier}"
        return StageWarning(
            f"its first frame looks touched: {which} is taken as the untouched sensor; if that is touched as well, "
            "give a picture of the untouched sensor with --reference"
        )
    if steadier:
        return f"the median of its first {steadier + 1} frames, all alike, is taken as the untouched sensor"
    return "its first frame is taken as the untouched sensor"


def _following(video: _Video, begins: int) -> Iterator[Image]:
    """The frames after `begins`, as far as they can be decoded."""
    try:
        for index in range(begins + 1, video.n_frames):
            yield video.frame(index)
    except FileProblem:
        return


def _spread(video: _Video) -> Iterator[tuple[int, Image]]:
    """Some frames spread evenly over the video, each with its index, as far as they can be decoded."""
    count = min(_MOST_LOOKED_AT, video.n_frames - 1)
    for index in sorted({round(i) for i in np.linspace(1, video.n_frames - 1, count)}) if count else ():
        with contextlib.suppress(FileProblem):
            yield index, video.frame(index)


class _Video:
    """A decoder that goes on from where it is when the next frame is asked for, and seeks otherwise."""

    def __init__(self, path: Path) -> None:
        os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # quiet: what is wrong is said by our own sentence
        import cv2

        if not is_text(str(path)):
            raise FileProblem("the name of a video must be UTF-8, this one is not; rename it", path)
        self._cv2: Any = cv2
        self._path, self._lock, self._next = path, threading.Lock(), 0
        self._capture: Any = cv2.VideoCapture(str(path))
        self.n_frames = int(self._capture.get(cv2.CAP_PROP_FRAME_COUNT)) if self._capture.isOpened() else 0
        if not 1 <= self.n_frames <= _MOST_FRAMES:
            self._capture.release()
            raise FileProblem("the video cannot be opened; it is damaged or of a kind that cannot be decoded", path)
        self.rate_hz = float(self._capture.get(cv2.CAP_PROP_FPS)) or float("nan")

    def frame(self, index: int) -> Image:
        """(rows, cols, 3) RGB."""
        with self._lock:
            if index != self._next:
                self._capture.set(self._cv2.CAP_PROP_POS_FRAMES, index)
            read, pixels = self._capture.read()
            self._next = index + 1 if read else -1
        if not read:
            raise FileProblem(f"frame {index} of the video cannot be decoded", self._path, field=f"frame {index}")
        return freeze(np.ascontiguousarray(pixels[:, :, ::-1]))

    def close(self) -> None:
        self._capture.release()
