"""Read single image files as RGB arrays; EXIF rotation is ignored, truncated files are refused."""

import re
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray

from pipeline.core.arrays import Image, freeze
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


def read_raw_pixels(path: Path) -> NDArray[np.generic]:
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
    return cast("NDArray[np.generic]", pixels)


def read_rgb(path: Path) -> Image:
    """(rows, cols, 3) uint8 RGB of an image file.

    Raises FileProblem for a damaged file or other than 8 bits.
    """
    pixels = read_raw_pixels(path)
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
