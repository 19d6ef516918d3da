"""Single image files as arrays: always RGB, never turned by their EXIF tag, refused when cut short."""

from __future__ import annotations

import re
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Image, freeze
from pipeline.base.errors import FileProblem
from pipeline.base.files import read_bytes

IMAGE_SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp"})
_REFERENCE = re.compile(r"^(background|bg|ref|reference|untouched|undeformed)([\W_\d].*)?$", re.IGNORECASE)
_UNTOUCHED_ARRAY = re.compile(r"(^|_)(background|bg|ref|reference|untouched|undeformed|base)(_|$)", re.IGNORECASE)
_TAIL_BYTES = 4096  # editors may write a little after the end mark


def is_image_file(path: Path) -> bool:
    """Whether the name says that this is an image file."""
    return path.suffix.lower() in IMAGE_SUFFIXES and not path.name.startswith(".")


def is_reference_file(path: Path) -> bool:
    """Whether the name says that this picture shows the untouched sensor."""
    return _REFERENCE.match(path.stem) is not None


def is_reference_key(key: str) -> bool:
    """Whether an array of this name shows the untouched sensor."""
    return _UNTOUCHED_ARRAY.search(key) is not None


def natural_sort_key(path: Path) -> tuple[object, ...]:
    """Sorts frame_2 before frame_10."""
    return tuple((0, int(p), "") if p.isdecimal() else (1, 0, p.lower()) for p in re.split(r"(\d+)", path.stem) if p)


def read_raw_pixels(path: Path) -> NDArray[np.generic]:
    """The pixels as stored, colours in the decoder's order; raises FileProblem when they cannot be read whole."""
    import cv2

    data = read_bytes(path, "the image")
    if not _is_whole(data):
        raise FileProblem("the image ends too early; it is cut short or still being written", path)
    try:
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED | cv2.IMREAD_IGNORE_ORIENTATION)
    except cv2.error:
        pixels = None
    if pixels is None:
        raise FileProblem("the image cannot be decoded; it is damaged or not an image", path)
    return cast("NDArray[np.generic]", pixels)


def read_rgb(path: Path) -> Image:
    """(rows, cols, 3) uint8 RGB of an image file; raises FileProblem when it is damaged or has not 8 bits."""
    pixels = read_raw_pixels(path)
    if pixels.dtype != np.uint8:
        raise FileProblem(f"a colour image must have 8 bits per channel, this one is {pixels.dtype}", path)
    if pixels.ndim == 2:
        return freeze(np.repeat(cast("Image", pixels)[:, :, None], 3, axis=2))
    return freeze(np.ascontiguousarray(cast("Image", pixels)[:, :, 2::-1]))  # the decoder gives BGR or BGRA


def _is_whole(data: bytes) -> bool:
    """Decoders fill what is missing with grey; the end marks of PNG and JPEG tell."""
    if data.startswith(b"\x89PNG"):
        return b"IEND" in data[-_TAIL_BYTES:]
    if data.startswith(b"\xff\xd8"):
        return b"\xff\xd9" in data[-_TAIL_BYTES:]
    return len(data) > 0
