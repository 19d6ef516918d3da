"""Read a video file of one sensor frame by frame."""

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
from pipeline.base.files import require_file
from pipeline.base.native_stderr import silence_native_libraries
from pipeline.base.stage_warnings import StageWarning
from pipeline.base.text import is_utf8_encodable
from pipeline.recordings import difference_images, image_files
from pipeline.recordings.formats import ReadOptions, RecordingFiles
from pipeline.recordings.gel_images import make_gel_converter
from pipeline.recordings.index_check import with_index_check
from pipeline.recordings.reference_denoising import denoise_reference
from pipeline.recordings.reference_selection import select_reference_frame
from pipeline.values.frames import Recording, Stream, TactileFrame

_MAX_CANDIDATES = 16  # frames searched for a reference: seeking in a long video is slow
_MAX_FRAMES = 10_000_000  # an hour at 2,700 Hz
_LEAST_FRAME_BYTES = 8  # of one frame in a file: its entry in the index


def read(files: RecordingFiles, options: ReadOptions) -> Recording:
    """The video as one stream of RGB frames; without a stated reference its first frames are the reference.

    Where the video clearly begins with a touch, a later frame is the reference, with a warning.
    Raises FileProblem for a video or first frame that cannot be decoded.
    """
    path, video = files.path, _Video(files.path)
    first = video.frame(0)
    is_difference = options.reference is None and difference_images.estimate_no_change_grey(first) is not None
    reference, start, n_averaged = None if is_difference else first, 0, 0
    if options.reference is not None:
        reference = image_files.read_rgb(options.reference)
        if reference.shape != first.shape:
            video.close()
            raise FileProblem(f"the reference has shape {reference.shape}, the video {first.shape}", options.reference)
    elif reference is not None:
        start, reference = select_reference_frame(reference, _sample_frames(video)) or (0, reference)
        reference, n_averaged = denoise_reference(reference, _frames_after(video, start))
    converter = make_gel_converter(options.sensor, (first.shape[0], first.shape[1]), reference, lambda: first)
    about = () if is_difference else (_describe_reference(options.reference, start, n_averaged),)

    def frame(index: int) -> TactileFrame:
        image = converter.convert_image(video.frame(index))
        return TactileFrame(sensor=converter.sensor, image=image, reference=converter.reference, index=index,
                            time_s=index / video.rate_hz, origin=f"{path} [frame {index}]")  # fmt: skip

    stream = Stream(name=converter.sensor or "video", sensor=converter.sensor, n_frames=video.n_frames,
                    frame=with_index_check(frame, video.n_frames, path))  # fmt: skip
    notes = (*files.notes, *converter.notes, *about, "times follow from the frame rate that the file states")
    return Recording(path=path, format="video", streams=(stream,), close=video.close, notes=notes)


def _describe_reference(reference: Path | None, start: int, n_averaged: int) -> str:
    if reference is not None:
        return f"{reference.name} is the reference"
    if start:
        which = f"frame {start}" if not n_averaged else f"the median of frames {start} to {start + n_averaged}"
        return StageWarning(
            f"the first frame shows contact, so {which} is taken as the reference; if it shows contact too, depth is "
            "wrong: give a reference image with --reference"
        )
    if n_averaged:
        return f"the median of the first {n_averaged + 1} frames, all alike, is taken as the reference"
    return "the first frame is taken as the reference"


def _frames_after(video: _Video, start: int) -> Iterator[Image]:
    """The frames after `start`, up to the first that cannot be decoded."""
    try:
        for index in range(start + 1, video.n_frames):
            yield video.frame(index)
    except FileProblem:
        return


def _sample_frames(video: _Video) -> Iterator[tuple[int, Image]]:
    """(index, frame) of frames spread evenly over the video; those that cannot be decoded are skipped."""
    count = min(_MAX_CANDIDATES, video.n_frames - 1)
    for index in sorted({round(i) for i in np.linspace(1, video.n_frames - 1, count)}) if count else ():
        with contextlib.suppress(FileProblem):
            yield index, video.frame(index)


class _Video:
    """A decoder that seeks only where frames are not read in order."""

    def __init__(self, path: Path) -> None:
        os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # quiet: this module raises its own errors
        import cv2

        if not is_utf8_encodable(str(path)):
            raise FileProblem("the name of a video must be UTF-8; rename it", path)
        self._cv2: Any = cv2
        self._path, self._lock, self._next = path, threading.Lock(), 0
        require_file(path, "the video", most_bytes=1 << 50)
        most_frames = min(_MAX_FRAMES, path.stat().st_size // _LEAST_FRAME_BYTES)
        with silence_native_libraries():
            self._capture: Any = cv2.VideoCapture(str(path))
            self.n_frames = int(self._capture.get(cv2.CAP_PROP_FRAME_COUNT)) if self._capture.isOpened() else 0
        if not 1 <= self.n_frames <= most_frames:
            self._capture.release()
            raise FileProblem("the video cannot be opened; it is damaged or cannot be decoded", path)
        self.rate_hz = float(self._capture.get(cv2.CAP_PROP_FPS)) or float("nan")

    def frame(self, index: int) -> Image:
        """(rows, cols, 3) RGB."""
        with self._lock, silence_native_libraries():
            if index != self._next:
                self._capture.set(self._cv2.CAP_PROP_POS_FRAMES, index)
            read, pixels = self._capture.read()
            self._next = index + 1 if read else -1
        if not read:
            raise FileProblem(f"frame {index} of the video cannot be decoded", self._path, field=f"frame {index}")
        return freeze(np.ascontiguousarray(pixels[:, :, ::-1]))

    def close(self) -> None:
        self._capture.release()
