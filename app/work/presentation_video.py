"""A presentation as a video: H.264 where ffmpeg has it, else MJPEG, which every player reads."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PyQt6.QtCore import QSize
from PyQt6.QtGui import QImage

from app.session.state import Session
from app.work.evaluator import Evaluator
from app.work.jobs import JobReporter
from app.work.presentation import choose_presented_stages, make_panes
from pipeline.base.errors import FileProblem
from pipeline.base.files import open_atomic, prepare_folder_for
from pipeline.previews.contrast import FittedContrast
from pipeline.translation.translate import Translation
from widgets.presentation_view import compose

RATE_HZ = 10.0  # as the timeline plays
_TIMEOUT_S = 30.0
_H264 = ("-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "18", "-movflags", "+faststart")
WriteFrame = Callable[[NDArray[np.uint8]], object]  # (rows, cols, 3) RGB


def find_h264_encoder() -> str:
    """Return the path of an ffmpeg that encodes H.264; "" where there is none."""
    ffmpeg = shutil.which("ffmpeg")
    if ffmpeg is None:
        return ""
    try:
        listed = subprocess.run(  # noqa: S603 - no shell, and the program is the PATH's own
            [ffmpeg, "-hide_banner", "-encoders"], capture_output=True, timeout=_TIMEOUT_S, check=False
        )
    except (OSError, subprocess.SubprocessError):
        return ""
    return ffmpeg if b" libx264 " in listed.stdout else ""


def write_presentation(session: Session, evaluator: Evaluator, size: QSize, path: Path, report: JobReporter) -> str:
    """Write every frame of the session's recording as it is presented at `size`; returns the codec.

    Frames are at even sizes and `RATE_HZ`. Raises TouchError for a file that cannot be written.
    """
    prepare_folder_for(path)
    size = QSize(size.width() // 2 * 2, size.height() // 2 * 2)
    opened, _ = evaluator.open_frame(session, report)
    ffmpeg = find_h264_encoder() if path.suffix.lower() == ".mp4" else ""
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder) / f"video{path.suffix.lower()}"
        writer = _PipeWriter(ffmpeg, made, size) if ffmpeg else _JpegWriter(made, size)
        try:
            _write_frames(session, opened, evaluator, size, writer.write, report)
        finally:
            writer.close()
        if not made.is_file() or not made.stat().st_size:
            raise FileProblem(f"the video could not be encoded as {writer.codec} (no room for it?)", path)
        with made.open("rb") as video, open_atomic(path, "the video") as file:
            shutil.copyfileobj(video, file)
    return writer.codec


def _write_frames(
    session: Session, opened: Translation, evaluator: Evaluator, size: QSize, write: WriteFrame, report: JobReporter
) -> None:
    contrast, stages = FittedContrast(), choose_presented_stages(opened)
    for index in range(opened.n_frames):
        report.step(index / opened.n_frames, f"frame {index}")
        parts = _Parts(report)
        evaluator.evaluate_frame(session.with_updates(frame=index), stages, parts, with_truth=True)
        panes = make_panes(opened, parts.shown, contrast)
        write(_to_array(compose(panes, size)))


class _Parts(JobReporter):
    """Collects what a frame delivers; cancelled with the job that it is part of."""

    def __init__(self, whole: JobReporter) -> None:
        super().__init__(whole.job, whole.ticket)
        self.cancelled = whole.cancelled
        self.shown: dict[str, object] = {}

    def step(self, fraction: float, text: str) -> None:
        if self.cancelled.is_set():
            super().step(fraction, text)

    def deliver(self, part: object) -> None:
        result = getattr(part, "result", None)
        self.shown["source" if result is None else result.name] = part


def _to_array(image: QImage) -> NDArray[np.uint8]:
    rgb = image.convertToFormat(QImage.Format.Format_RGB888)
    bits: Any = rgb.constBits()
    bits.setsize(rgb.sizeInBytes())
    rows = np.frombuffer(bits, np.uint8).reshape(rgb.height(), rgb.bytesPerLine())
    return rows[:, : 3 * rgb.width()].reshape(rgb.height(), rgb.width(), 3).copy()


class _PipeWriter:
    """Passes frames to ffmpeg."""

    codec = "H.264"

    def __init__(self, ffmpeg: str, path: Path, size: QSize) -> None:
        shape = f"{size.width()}x{size.height()}"
        raw = ("-f", "rawvideo", "-pix_fmt", "rgb24", "-s", shape, "-r", f"{RATE_HZ:g}", "-i", "-")
        self._process = subprocess.Popen(  # noqa: S603 - as above
            [ffmpeg, "-loglevel", "error", "-y", *raw, *_H264, str(path)],
            stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip

    def write(self, pixels: NDArray[np.uint8]) -> None:
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(pixels.tobytes())
        except BrokenPipeError as error:
            raise FileProblem("ffmpeg stopped before the video was complete (no room for it?)", "ffmpeg") from error

    def close(self) -> None:
        self._process.communicate(timeout=_TIMEOUT_S)


class _JpegWriter:
    """Writes frames by OpenCV."""

    codec = "MJPEG"

    def __init__(self, path: Path, size: QSize) -> None:
        import cv2

        codec: Any = cv2.VideoWriter.fourcc(*"MJPG")
        self._writer: Any = cv2.VideoWriter(str(path), codec, RATE_HZ, (size.width(), size.height()))

    def write(self, pixels: NDArray[np.uint8]) -> None:
        self._writer.write(np.ascontiguousarray(pixels[:, :, ::-1]))

    def close(self) -> None:
        self._writer.release()
