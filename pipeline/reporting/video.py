"""Write videos: encoded in a temporary folder, read back, then put in their place.

An .mp4 is H.264 where an ffmpeg with libx264 is on the PATH, else OpenCV's MPEG-4; an .avi is MJPEG.
"""

import shutil
import subprocess
import tempfile
from collections.abc import Callable, Generator, Iterable
from contextlib import contextmanager
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base.arrays import Image
from pipeline.base.errors import FileProblem
from pipeline.base.files import check_folder_for, open_atomic
from pipeline.base.native_stderr import silence_native_libraries

CODECS = {".mp4": ("mp4v", "MPEG-4"), ".avi": ("MJPG", "MJPEG")}  # OpenCV's name of the codec, and the usual one
_TIMEOUT_S = 30.0
_H264 = ("-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "18", "-movflags", "+faststart")
_WriteImage = Callable[[Image], object]


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


def write_video(path: Path, images: Iterable[Image], rate_hz: float) -> str:
    """Write images (rows, cols, 3) of equal, even sizes, each once; returns the codec. Raises FileProblem."""
    suffix, images = path.suffix.lower(), iter(images)
    if suffix not in CODECS:
        raise FileProblem(f"videos are written as {' or '.join(CODECS)}", path)
    ffmpeg = find_h264_encoder() if suffix == ".mp4" else ""
    first, n_images = next(images), 0
    check_folder_for(path)
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder) / f"video{suffix}"
        with _encode_by_ffmpeg(ffmpeg, made, first, rate_hz) if ffmpeg else _encode(made, first, rate_hz) as write:
            for pixels in chain([first], images):
                write(pixels)
                n_images += 1
        if count_frames(made) < n_images:  # the encoder does not report a full disk
            raise FileProblem(f"cannot write the video (no room for it in {folder!r}?)", path)
        with made.open("rb") as video, open_atomic(path, "the video", None) as file:
            shutil.copyfileobj(video, file)
    return "H.264" if ffmpeg else CODECS[suffix][1]


@contextmanager
def _encode(path: Path, first: Image, rate_hz: float) -> Generator[_WriteImage]:
    import cv2

    codec: Any = cv2.VideoWriter.fourcc(*CODECS[path.suffix][0])
    with silence_native_libraries():
        writer = cv2.VideoWriter(str(path), codec, rate_hz, (first.shape[1], first.shape[0]))
    if not writer.isOpened():
        raise FileProblem("this machine's OpenCV cannot write such a video; try .avi or .mp4", path)
    try:
        yield lambda pixels: writer.write(np.ascontiguousarray(pixels[:, :, ::-1]))
    finally:
        writer.release()


@contextmanager
def _encode_by_ffmpeg(ffmpeg: str, path: Path, first: Image, rate_hz: float) -> Generator[_WriteImage]:
    shape = f"{first.shape[1]}x{first.shape[0]}"
    raw = ("-f", "rawvideo", "-pix_fmt", "rgb24", "-s", shape, "-r", f"{rate_hz:g}", "-i", "-")
    process = subprocess.Popen(  # noqa: S603 - as above
        [ffmpeg, "-loglevel", "error", "-y", *raw, *_H264, str(path)],
        stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    pipe = process.stdin
    assert pipe is not None
    try:
        yield lambda pixels: pipe.write(np.ascontiguousarray(pixels).tobytes())
    except BrokenPipeError as error:
        raise FileProblem("ffmpeg stopped before the video was complete (no room for it?)", path) from error
    finally:
        process.communicate(timeout=_TIMEOUT_S)


def count_frames(video: Path) -> int:
    """Return the number of frames that can be read."""
    import cv2

    with silence_native_libraries():
        reader, n = cv2.VideoCapture(str(video)), 0
        while reader.grab():
            n += 1
        reader.release()
    return n
