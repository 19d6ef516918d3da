"""Write videos: encoded in a temporary folder, read back, then put in their place.

An .mp4 is H.264 where an ffmpeg with libx264 is on the PATH, else OpenCV's MPEG-4; an .avi is
MJPEG. Browsers play .webm, which is VP8, and .webp, an animated image that loops and is held in
memory until it is written.
"""

import contextlib
import os
import shutil
import signal
import subprocess
import tempfile
import threading
from collections.abc import Callable, Generator, Iterable
from contextlib import contextmanager
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.core.arrays import Image
from pipeline.core.errors import FileProblem
from pipeline.core.files import check_folder_for, open_atomic
from pipeline.core.native_stderr import silence_native_libraries

# OpenCV's name of the codec, and the usual one
CODECS = {
    ".mp4": ("mp4v", "MPEG-4"),
    ".avi": ("MJPG", "MJPEG"),
    ".webm": ("VP80", "VP8"),
    ".webp": ("", "WebP"),
}
_WEBP_QUALITY = 60  # of 100
_WEBP_BYTES = 2 * 1024**3  # of its images in memory
_LIST_S = 10.0  # in which ffmpeg lists its encoders
_STALL_S = 30.0  # that ffmpeg may take for one image
_FINISH_S = 600.0  # and to end after the last
_H264 = ("-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "18", "-movflags", "+faststart")
_WriteImage = Callable[[Image], object]


def find_h264_encoder() -> str:
    """Return the path of an ffmpeg that encodes H.264; "" where there is none."""
    ffmpeg = shutil.which("ffmpeg")
    if ffmpeg is None:
        return ""
    with (
        contextlib.suppress(OSError, subprocess.SubprocessError),
        tempfile.TemporaryFile() as listed,
    ):
        with _start([ffmpeg, "-hide_banner", "-encoders"], subprocess.DEVNULL, listed) as process:
            process.wait(_LIST_S)
        listed.seek(0)
        if b" libx264 " in listed.read():
            return ffmpeg
    return ""


@contextmanager
def _start(command: list[str], stdin: int, stdout: Any) -> Generator[subprocess.Popen[bytes]]:
    """A process that has ended when the block has, with all that it started."""
    process = subprocess.Popen(  # noqa: S603 - no shell, and the program is the PATH's own
        command,
        stdin=stdin,
        stdout=stdout,
        stderr=subprocess.DEVNULL,
        bufsize=0,
        start_new_session=True,
    )
    try:
        yield process
    finally:
        with contextlib.suppress(OSError):  # all have ended
            os.killpg(process.pid, signal.SIGKILL)
        if process.stdin is not None:
            process.stdin.close()
        process.wait()


def write_video(path: Path, images: Iterable[Image], rate_hz: float) -> str:
    """Write images (rows, cols, 3) of equal, even sizes, each once.

    Returns the codec. Raises FileProblem.
    """
    suffix = path.suffix.lower()
    images = iter(images)
    if suffix not in CODECS:
        raise FileProblem(f"videos are written as {' or '.join(CODECS)}", path)
    ffmpeg = find_h264_encoder() if suffix == ".mp4" else ""
    first = next(images)
    n_images = 0
    check_folder_for(path)
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder) / f"video{suffix}"
        if ffmpeg:
            encode = _encode_by_ffmpeg(ffmpeg, made, first, rate_hz)
        elif suffix == ".webp":
            encode = _encode_webp(made, rate_hz)
        else:
            encode = _encode(made, first, rate_hz)
        try:
            with encode as write:
                for pixels in chain([first], images):
                    write(pixels)
                    n_images += 1
        except FileProblem as error:
            raise error.relocate(path, instead_of=made) from error
        # the encoder does not report a full disk; a .webp holds equal images once
        if count_frames(made) < (1 if suffix == ".webp" else n_images):
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
def _encode_webp(path: Path, rate_hz: float) -> Generator[_WriteImage]:
    import cv2

    images: list[Image] = []

    def keep(pixels: Image) -> None:
        if len(images) * pixels.nbytes > _WEBP_BYTES:
            raise FileProblem(
                f"{len(images)} images of this size fill the memory; write .webm, or fewer frames",
                path,
            )
        images.append(np.ascontiguousarray(pixels[:, :, ::-1]))

    yield keep
    film = cv2.Animation()
    film.frames = images
    film.durations = [round(1000.0 / rate_hz)] * len(images)
    if not cv2.imwriteanimation(str(path), film, [cv2.IMWRITE_WEBP_QUALITY, _WEBP_QUALITY]):
        raise FileProblem("this machine's OpenCV cannot write animations; write .webm", path)


@contextmanager
def _encode_by_ffmpeg(
    ffmpeg: str, path: Path, first: Image, rate_hz: float
) -> Generator[_WriteImage]:
    shape = f"{first.shape[1]}x{first.shape[0]}"
    raw = ("-f", "rawvideo", "-pix_fmt", "rgb24", "-s", shape, "-r", f"{rate_hz:g}", "-i", "-")
    command = [ffmpeg, "-loglevel", "error", "-y", *raw, *_H264, str(path)]
    with _start(command, subprocess.PIPE, subprocess.DEVNULL) as process:
        pipe = process.stdin
        assert pipe is not None

        def write(pixels: Image) -> None:
            with _ending_after_stall(process):
                pipe.write(np.ascontiguousarray(pixels).tobytes())

        try:
            yield write
            pipe.close()
            process.wait(_FINISH_S)
        except (BrokenPipeError, subprocess.TimeoutExpired) as error:
            raise FileProblem(
                "ffmpeg stopped (no room for the video?), or did nothing for "
                f"{_STALL_S:g} s; free some room, take it from the PATH, or write .avi",
                path,
            ) from error


@contextmanager
def _ending_after_stall(process: subprocess.Popen[bytes]) -> Generator[None]:
    """End the process where the block takes `_STALL_S`."""
    watch = threading.Timer(_STALL_S, os.killpg, (process.pid, signal.SIGKILL))
    watch.start()
    try:
        yield
    finally:
        watch.cancel()


def count_frames(video: Path) -> int:
    """Return the number of frames that can be read."""
    import cv2

    if video.suffix == ".webp":
        return _count_webp(video)
    with silence_native_libraries():
        reader = cv2.VideoCapture(str(video))
        n = 0
        while reader.grab():
            n += 1
        reader.release()
    return n


def _count_webp(video: Path) -> int:
    """Return the number of images, where equal ones after each other are one that lasts longer; 0
    where the end is missing.

    OpenCV unfolds all of them to tell.
    """
    import PIL.Image

    try:
        with PIL.Image.open(video) as film:
            return getattr(film, "n_frames", 1)
    except OSError:
        return 0
