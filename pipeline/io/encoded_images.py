"""Images that are stored inside other files, as PNG or JPEG or as plain pixels."""

from pathlib import Path
from typing import Any

import numpy as np

from pipeline.core.arrays import Image, freeze
from pipeline.core.errors import FileProblem
from pipeline.core.native_stderr import silence_native_libraries

# encoding of ROS and Foxglove -> the channels that are red, green and blue, and how many there are
_CHANNELS = {
    "rgb8": ((0, 1, 2), 3), "bgr8": ((2, 1, 0), 3), "8UC3": ((2, 1, 0), 3), "rgba8": ((0, 1, 2), 4),
    "bgra8": ((2, 1, 0), 4), "mono8": ((0, 0, 0), 1), "8UC1": ((0, 0, 0), 1),
}  # fmt: skip


# two bytes a pixel
_YUV = {"yuv422_yuy2": "YUY2", "yuyv": "YUY2", "yuv422": "UYVY", "uyvy": "UYVY"}
_DEPTH = ("16UC1", "mono16", "32FC1")
NO_DEPTH = (
    "depth inside such a file is not read; export it as an .npz with an array depth_mm "
    "and its timestamps_s"
)


def decode_rgb(content: bytes, where: str, path: Path) -> Image:
    """(rows, cols, 3) RGB of a PNG or JPEG; raises FileProblem."""
    import cv2

    pixels: Any = None
    try:
        with silence_native_libraries():
            # the first alone would halve 16 bits to black
            flags = cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH
            pixels = cv2.imdecode(np.frombuffer(content, np.uint8), flags) if content else None
    except cv2.error:
        pixels = None
    if pixels is None:
        raise FileProblem(f"{where} cannot be decoded", path, field=where)
    if pixels.dtype != np.uint8:
        raise FileProblem(
            f"{where} has {8 * pixels.itemsize} bits a pixel: {NO_DEPTH}", path, field=where
        )
    return freeze(np.ascontiguousarray(pixels[:, :, ::-1]))


def unpack_rgb(
    content: bytes, shape: tuple[int, int], step: int, encoding: str, where: str, path: Path
) -> Image:
    """(rows, cols, 3) RGB of plain pixels, `step` bytes a row; raises FileProblem."""
    if encoding in _DEPTH:
        raise FileProblem(f"{where} has the encoding {encoding!r}: {NO_DEPTH}", path, field=where)
    known = (*_CHANNELS, *_YUV)
    if encoding not in known:
        raise FileProblem(
            f"{where} has the encoding {encoding!r}, which is not read; record one of "
            f"{', '.join(known)}",
            path,
            field=where,
        )
    order, n_channels = _CHANNELS.get(encoding, ((), 2))
    rows, cols = shape
    if min(shape) < 1 or step < cols * n_channels or rows * step > len(content):
        raise FileProblem(
            f"{where} has fewer bytes than its size of {cols} x {rows} px needs", path, field=where
        )
    lines = np.frombuffer(content, np.uint8, rows * step).reshape(rows, step)
    pixels = lines[:, : cols * n_channels].reshape(rows, cols, n_channels)
    if order:
        return freeze(np.ascontiguousarray(pixels[:, :, order]))
    import cv2

    if cols % 2:
        raise FileProblem(
            f"{where} has an odd width of {cols} px, which {encoding} cannot have",
            path,
            field=where,
        )
    rgb: Any = cv2.cvtColor(
        np.ascontiguousarray(pixels), getattr(cv2, f"COLOR_YUV2RGB_{_YUV[encoding]}")
    )
    return freeze(rgb)
