"""Images that are stored inside other files, as PNG or JPEG or as plain pixels."""

from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base.arrays import Image, freeze
from pipeline.base.errors import FileProblem
from pipeline.base.native_stderr import silence_native_libraries

_CHANNELS = {  # encoding of ROS and Foxglove -> the channels that are red, green and blue, and how many there are
    "rgb8": ((0, 1, 2), 3), "bgr8": ((2, 1, 0), 3), "8UC3": ((2, 1, 0), 3), "rgba8": ((0, 1, 2), 4),
    "bgra8": ((2, 1, 0), 4), "mono8": ((0, 0, 0), 1), "8UC1": ((0, 0, 0), 1),
}  # fmt: skip


def decode_rgb(content: bytes, where: str, path: Path) -> Image:
    """(rows, cols, 3) RGB of a PNG or JPEG; raises FileProblem."""
    import cv2

    pixels: Any = None
    try:
        with silence_native_libraries():
            pixels = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR) if content else None
    except cv2.error:
        pixels = None
    if pixels is None:
        raise FileProblem(f"{where} cannot be decoded", path, field=where)
    return freeze(np.ascontiguousarray(pixels[:, :, ::-1]))


def unpack_rgb(content: bytes, shape: tuple[int, int], step: int, encoding: str, where: str, path: Path) -> Image:
    """(rows, cols, 3) RGB of plain pixels, `step` bytes a row; raises FileProblem."""
    if encoding not in _CHANNELS:
        raise FileProblem(f"{where} has the encoding {encoding!r}; known are {', '.join(_CHANNELS)}", path, field=where)
    order, n_channels = _CHANNELS[encoding]
    rows, cols = shape
    if min(shape) < 1 or step < cols * n_channels or rows * step > len(content):
        raise FileProblem(f"{where} has fewer bytes than its size of {cols} x {rows} px needs", path, field=where)
    lines = np.frombuffer(content, np.uint8, rows * step).reshape(rows, step)
    pixels = lines[:, : cols * n_channels].reshape(rows, cols, n_channels)
    return freeze(np.ascontiguousarray(pixels[:, :, order]))
