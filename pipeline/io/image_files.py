"""Read single image files as RGB arrays; EXIF rotation is ignored, truncated files are refused."""

import re
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from pipeline.core.arrays import Image, Stored, describe_size, freeze
from pipeline.core.errors import FileProblem
from pipeline.core.files import read_bytes
from pipeline.core.native_stderr import silence_native_libraries
from pipeline.io.formats import IMAGE_SUFFIXES

NO_REFERENCE_NOTE = (
    "no reference image was found; name one with --reference, or make one with --reference-frames"
)
_REFERENCE_STEM = re.compile(
    r"^(background|bg|ref|reference|untouched|undeformed)([\W_\d].*)?$"
    r"|^[a-z]+[\W_](background|bg|ref|reference|untouched|undeformed)$",  # left_background
    re.IGNORECASE,
)
_REFERENCE_KEY = re.compile(
    r"(^|_)(background|bg|ref|reference|untouched|undeformed|base)(_|$)", re.IGNORECASE
)
# at the end of a file in which the end mark is searched: editors append a little
_TAIL_BYTES = 4096


def is_image_file(path: Path) -> bool:
    """Whether the suffix is that of an image and the file is not hidden."""
    return path.suffix.lower() in IMAGE_SUFFIXES and not path.name.startswith(".")


def is_reference_file(path: Path) -> bool:
    """Whether the name is that of a reference image."""
    return _REFERENCE_STEM.match(path.stem) is not None


def is_reference_key(key: str) -> bool:
    """Whether the name is that of a reference array."""
    return _REFERENCE_KEY.search(key) is not None


def read_raw_pixels(path: Path) -> Stored:
    """The pixels as stored, colours as BGR(A).

    Raises FileProblem for a damaged or truncated file.
    """
    import cv2

    data = read_bytes(path, "the image")
    if not _is_whole(data):
        raise FileProblem("the image ends too early; it is cut short or still being written", path)
    try:
        with silence_native_libraries():
            pixels = cv2.imdecode(
                np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED | cv2.IMREAD_IGNORE_ORIENTATION
            )
    except cv2.error:
        pixels = None
    if pixels is None:
        raise FileProblem(
            "the image cannot be decoded; it is damaged, too large or not an image", path
        )
    return cast("Stored", pixels)


def read_rgb(path: Path) -> Image:
    """(rows, cols, 3) uint8 RGB of an image file.

    Raises FileProblem for a damaged file or other than 8 bits.
    """
    return to_rgb(read_raw_pixels(path), path)


def to_rgb(pixels: NDArray[np.generic], path: Path) -> Image:
    """(rows, cols, 3) uint8 RGB of stored pixels; raises FileProblem for other than 8 bits."""
    if pixels.dtype != np.uint8:
        how = "divide by 257" if pixels.dtype == np.uint16 else "multiply by 255 where 1 is white"
        what = f"a colour image must have 8 bits per channel, this one has {pixels.dtype}"
        raise FileProblem(f"{what}; {how} and save it as uint8", path)
    if pixels.ndim == 2:
        return freeze(np.repeat(cast("Image", pixels)[:, :, None], 3, axis=2))
    return freeze(np.ascontiguousarray(cast("Image", pixels)[:, :, 2::-1]))  # from BGR or BGRA


def _is_whole(data: bytes) -> bool:
    """Whether PNG or JPEG data has its end mark; decoders fill missing rows with grey."""
    if data.startswith(b"\x89PNG"):
        return b"IEND" in data[-_TAIL_BYTES:]
    if data.startswith(b"\xff\xd8"):
        return b"\xff\xd9" in data[-_TAIL_BYTES:]
    return len(data) > 0


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
        raise FileProblem(f"{where} cannot be decoded", path)
    if pixels.dtype != np.uint8:
        raise FileProblem(f"{where} has {8 * pixels.itemsize} bits a pixel: {NO_DEPTH}", path)
    return freeze(np.ascontiguousarray(pixels[:, :, ::-1]))


def unpack_rgb(
    content: bytes, shape: tuple[int, int], step: int, encoding: str, where: str, path: Path
) -> Image:
    """(rows, cols, 3) RGB of plain pixels, `step` bytes a row; raises FileProblem."""
    if encoding in _DEPTH:
        raise FileProblem(f"{where} has the encoding {encoding!r}: {NO_DEPTH}", path)
    known = (*_CHANNELS, *_YUV)
    if encoding not in known:
        raise FileProblem(
            f"{where} has the encoding {encoding!r}, which is not read; record one of "
            f"{', '.join(known)}",
            path,
        )
    order, n_channels = _CHANNELS.get(encoding, ((), 2))
    rows, cols = shape
    if min(shape) < 1 or step < cols * n_channels or rows * step > len(content):
        size = describe_size(shape)
        raise FileProblem(f"{where} has fewer bytes than its size of {size} needs", path)
    lines = np.frombuffer(content, np.uint8, rows * step).reshape(rows, step)
    pixels = lines[:, : cols * n_channels].reshape(rows, cols, n_channels)
    if order:
        return freeze(np.ascontiguousarray(pixels[:, :, order]))
    import cv2

    if cols % 2:
        raise FileProblem(
            f"{where} has an odd width of {cols} px, which {encoding} cannot have",
            path,
        )
    rgb: Any = cv2.cvtColor(
        np.ascontiguousarray(pixels), getattr(cv2, f"COLOR_YUV2RGB_{_YUV[encoding]}")
    )
    return freeze(rgb)
