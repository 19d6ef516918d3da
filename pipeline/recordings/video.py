"""Read a video file of one sensor frame by frame."""

import os
import threading
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base.arrays import Image, freeze
from pipeline.base.errors import FileProblem, is_utf8_encodable
from pipeline.base.files import require_file
from pipeline.base.native_stderr import silence_native_libraries
from pipeline.recordings.formats import ReadOptions, RecordingFiles
from pipeline.recordings.image_sequence import make_stream
from pipeline.values.frames import Recording

_MAX_FRAMES = 10_000_000  # an hour at 2,700 Hz
_LEAST_FRAME_BYTES = 8  # of one frame in a file: its entry in the index


def read(files: RecordingFiles, options: ReadOptions) -> Recording:
    """The video as one stream of RGB frames; see `image_sequence.make_stream`.

    Raises FileProblem for a video or first frame that cannot be decoded.
    """
    path, video = files.path, VideoDecoder(files.path)
    try:
        stream, notes = make_stream(video, path, options, name="")
    except Exception:
        video.close()
        raise
    notes = (*files.notes, *notes, "times follow from the frame rate that the file states")
    return Recording(path=path, format="video", streams=(stream,), close=video.close, notes=notes)


class VideoDecoder:
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

    def time_s(self, index: int) -> float:
        """Time of a frame by the stated frame rate."""
        return index / self.rate_hz

    def close(self) -> None:
        """Release the file."""
        self._capture.release()
