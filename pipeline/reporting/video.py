"""Write videos: encoded in a temporary folder, read back, then put in their place."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base.arrays import Image
from pipeline.base.errors import FileProblem
from pipeline.base.files import open_atomic
from pipeline.base.native_stderr import silence_native_libraries

CODECS = {".mp4": "mp4v", ".avi": "MJPG"}


def write_video(path: Path, images: Iterable[Image], rate_hz: float) -> None:
    """Write images (rows, cols, 3) of equal, even sizes as .mp4 or .avi, each once; raises FileProblem."""
    import cv2

    suffix = path.suffix.lower()
    if suffix not in CODECS:
        raise FileProblem(f"videos are written as {' or '.join(CODECS)}", path)
    codec: Any = cv2.VideoWriter.fourcc(*CODECS[suffix])
    with tempfile.TemporaryDirectory() as folder:
        made, writer, n_images = Path(folder) / f"video{suffix}", None, 0
        for pixels in images:
            if writer is None:
                with silence_native_libraries():
                    writer = cv2.VideoWriter(str(made), codec, rate_hz, (pixels.shape[1], pixels.shape[0]))
            writer.write(np.ascontiguousarray(pixels[:, :, ::-1]))
            n_images += 1
        if writer is None or not writer.isOpened():
            raise FileProblem("this machine's OpenCV cannot write such a video; try .avi or .mp4", path)
        writer.release()
        if count_frames(made) < n_images:  # the encoder does not report a full disk
            raise FileProblem(f"cannot write the video (no room for it in {folder!r}?)", path)
        with made.open("rb") as video, open_atomic(path, "the video") as file:
            shutil.copyfileobj(video, file)


def count_frames(video: Path) -> int:
    """Return the number of frames that can be read."""
    import cv2

    with silence_native_libraries():
        reader, n = cv2.VideoCapture(str(video)), 0
        while reader.grab():
            n += 1
        reader.release()
    return n
