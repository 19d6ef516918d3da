"""Read a video file of one sensor frame by frame."""

import os
import threading
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.core.arrays import Doubles, Image, freeze
from pipeline.core.errors import FileProblem, is_utf8_encodable
from pipeline.core.files import close_on_error, require_file
from pipeline.core.native_stderr import silence_native_libraries
from pipeline.core.values.frames import Recording
from pipeline.io.formats import ReadOptions, RecordingFiles
from pipeline.io.gel_streams import make_film, make_gel_stream

_MAX_FRAMES = 10_000_000  # an hour at 2,700 Hz
_LEAST_FRAME_BYTES = 8  # of one frame in a file: its entry in the index


def read(files: RecordingFiles, options: ReadOptions) -> Recording:
    """The video as one stream of RGB frames; see `make_gel_stream`.

    Raises FileProblem for a video or first frame that cannot be decoded.
    """
    path = files.path
    video = VideoDecoder(files.path)
    with close_on_error(video.close):
        film = make_film(path, video.n_frames, video.frame, video.times_s)
        stream, notes = make_gel_stream(film, path, options, name="")
    return Recording(
        path=path,
        format="video",
        streams=(stream,),
        close=video.close,
        notes=notes,
    )


class VideoDecoder:
    """A decoder that knows a frame by its time in the file, whatever was read before.

    The file's packets are listed once, undecoded: a stated number of frames is an estimate where
    the rate varies.
    """

    def __init__(self, path: Path) -> None:
        # quiet: this module raises its own errors
        os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
        import cv2

        if not is_utf8_encodable(str(path)):
            raise FileProblem("the name of a video must be UTF-8; rename it", path)
        self._cv2: Any = cv2
        self._path = path
        self._lock = threading.Lock()
        self._at = -1  # the frame that was decoded last
        require_file(path, "the video", most_bytes=1 << 50)
        most_frames = min(_MAX_FRAMES, path.stat().st_size // _LEAST_FRAME_BYTES)
        with silence_native_libraries():
            self._capture: Any = cv2.VideoCapture(str(path))
            n_stated = (
                int(self._capture.get(cv2.CAP_PROP_FRAME_COUNT)) if self._capture.isOpened() else 0
            )
            self._rate_hz = max(float(self._capture.get(cv2.CAP_PROP_FPS)), 0.0)  # a mean
            self._times_ms = (
                self._list_times_ms(n_stated) if n_stated <= most_frames else np.zeros(0)
            )
        self.n_frames = len(self._times_ms)
        self.times_s = 1e-3 * self._times_ms  # of the frames, as the file has them
        if not self.n_frames:
            self._capture.release()
            raise FileProblem(
                "the video cannot be opened; it is damaged or cannot be decoded", path
            )

    def _list_times_ms(self, n_stated: int) -> Doubles:
        """Times of the frames in the file, and of those that it lacks at its end."""
        packets: Any = self._cv2.VideoCapture(str(self._path))
        packets.set(self._cv2.CAP_PROP_FORMAT, -1)
        found = list[float]()
        while packets.grab():
            found.append(packets.get(self._cv2.CAP_PROP_POS_MSEC))
        packets.release()
        if not found:
            return np.zeros(0)
        # packets follow the decoding
        interval_ms = 1e3 / (self._rate_hz or 1.0)
        times_ms = np.sort(np.array(found))
        if not (np.isfinite(times_ms).all() and (np.diff(times_ms) > 0.0).all()):
            times_ms = np.arange(float(len(found))) * interval_ms
        last_ms = times_ms[-1]
        n_lacking = min(n_stated - len(found), n_stated - round(last_ms / interval_ms) - 1)
        return np.append(times_ms, last_ms + np.arange(1.0, n_lacking + 1) * interval_ms)

    def frame(self, index: int) -> Image:
        """(rows, cols, 3) RGB."""
        with self._lock, silence_native_libraries():
            if not self._at <= index <= self._at + 1:
                self._seek(index)
            while self._at < index:
                self._at = self._decode_next()
            pixels = self._capture.retrieve()[1] if self._at == index else None
        if pixels is None:
            raise FileProblem(f"frame {index} of the video cannot be decoded", self._path)
        return freeze(np.ascontiguousarray(pixels[:, :, ::-1]))

    def _seek(self, index: int) -> None:
        """Go to a frame at or before `index`.

        The library takes the rate for constant and may go too far.
        """
        goal = round(1e-3 * self._times_ms[index] * self._rate_hz)
        back = 0
        while True:
            start = max(goal - back, 0)
            self._capture.set(self._cv2.CAP_PROP_POS_FRAMES, start)
            self._at = self._decode_next()
            if self._at <= index or not start:
                return
            back = 2 * back + 8

    def _decode_next(self) -> int:
        """Decode one frame and return which it is, by its time.

        `n_frames` at the end of the file.
        """
        if not self._capture.grab():
            return self.n_frames
        middles_ms = 0.5 * (self._times_ms[1:] + self._times_ms[:-1])
        return int(np.searchsorted(middles_ms, self._capture.get(self._cv2.CAP_PROP_POS_MSEC)))

    def close(self) -> None:
        """Release the file."""
        self._capture.release()
