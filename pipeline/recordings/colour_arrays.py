"""Pictures of a gel kept as arrays, `.npy` or `.npz`: bytes, floats of 0 to 1 or 0 to 255, or signed differences."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Image, freeze
from pipeline.base.errors import FileProblem
from pipeline.base.text import escape_text
from pipeline.recordings import image_files
from pipeline.recordings.gel_images import make_gel_converter
from pipeline.recordings.index_check import with_index_check
from pipeline.values.frames import Recording, Stream, TactileFrame

_SMALLEST_PX = 8  # of a picture's sides; smaller arrays with three columns are points or matrices
_WHITE = 255.0


def find_colour_keys(arrays: Mapping[str, NDArray[Any]]) -> tuple[str, ...]:
    """Which arrays hold colour pictures (..., rows, cols, 3) or (..., 3, rows, cols)."""
    return tuple(k for k, a in arrays.items() if a.ndim in (3, 4) and a.dtype.kind in "fiu" and _axis(a) is not None)


def read(
    path: Path, arrays: Mapping[str, NDArray[Any]], *, sensor: str = "", reference: Path | None = None
) -> Recording:
    """One stream of RGB frames; an array whose name says that it is untouched, or `reference`, is the reference.

    Signed numbers are differences from the untouched picture, which they imply. Raises FileProblem or SettingProblem.
    """
    coloured = find_colour_keys(arrays)
    named = [k for k in coloured if image_files.is_reference_key(k)]
    shown = [k for k in coloured if k not in named]
    if len(shown) != 1:
        seen = ", ".join(f"{k} {arrays[k].shape}" for k in coloured)
        raise FileProblem(f"cannot tell which array holds the frames, looked at {seen}; keep one in the file", path)
    key = shown[0]
    stack = _frames(arrays[key])
    white, notes = _scale(stack, key, path)
    untouched = image_files.read_rgb(reference) if reference is not None else None
    about: tuple[str, ...] = () if reference is None else (f"{reference.name} shows the untouched sensor",)
    if untouched is None and named:
        base = _frames(arrays[named[0]])
        untouched = _bytes(base[0], _scale(base, named[0], path)[0])
        about = (f"{escape_text(named[0])} shows the untouched sensor",)
    shape = (int(stack.shape[1]), int(stack.shape[2]))
    if untouched is not None and untouched.shape[:2] != shape:
        raise FileProblem(f"the reference has shape {untouched.shape}, the frames {stack.shape[1:]}", path)
    signed = white < 0
    if signed and untouched is not None:
        raise FileProblem(f"{key} holds differences, which have no use for a reference; leave it out", path, field=key)

    def raw(index: int) -> NDArray[np.generic]:
        return (stack[index] * np.float32(-white)).astype(np.float32) if signed else _bytes(stack[index], white)

    made = make_gel_converter(sensor, shape, untouched, lambda: raw(0))
    if made.reference is None:
        about = ("no picture of the untouched sensor was found; name one with --reference",)

    def frame(index: int) -> TactileFrame:
        return TactileFrame(sensor=made.sensor, image=made.convert_image(raw(index)), reference=made.reference, index=index,
                            origin=f"{path} [{key} {index}]")  # fmt: skip

    stream = Stream(name=made.sensor or "images", sensor=made.sensor, n_frames=len(stack),
                    frame=with_index_check(frame, len(stack), path))  # fmt: skip
    return Recording(path=path, format="colour arrays", streams=(stream,), notes=(*made.notes, *notes, *about))


def _axis(array: NDArray[Any]) -> int | None:
    """Where the three colours lie: last (-1) or before rows and columns (-3)."""
    for axis, sides in ((-1, array.shape[-3:-1]), (-3, array.shape[-2:])):
        if array.shape[axis] == 3 and min(sides) >= _SMALLEST_PX:
            return axis
    return None


def _frames(array: NDArray[Any]) -> NDArray[Any]:
    """(frames, rows, cols, 3), still mapped from the disk where it was."""
    colours_last = array if _axis(array) == -1 else np.moveaxis(array, -3, -1)
    return colours_last if colours_last.ndim == 4 else colours_last[None]


def _scale(stack: NDArray[Any], key: str, path: Path) -> tuple[float, tuple[str, ...]]:
    """(what a grey level is multiplied with to reach 0..255, notes); below 0 for signed differences."""
    if not stack.size:
        raise FileProblem(f"{key} holds no frame", path, field=key)
    if stack.dtype == np.uint8:
        return 1.0, ()
    low, high = float(np.min(stack)), float(np.max(stack))
    if not np.isfinite([low, high]).all():
        raise FileProblem(f"{key} has values that are not finite", path, field=key)
    largest = max(-low, high)
    scale = _WHITE if largest <= 1.0 else 1.0
    if largest > _WHITE + 0.5:
        raise FileProblem(
            f"{key} must hold grey levels of 0 to 255, or 0 to 1, got {low:g} to {high:g}", path, field=key
        )
    one = "1 is white" if scale > 1 else "255 is white"
    if low < 0:
        return -scale, (f"{escape_text(key)} has negative values: {one}, and 0 is no change",)
    return scale, (f"{escape_text(key)} holds {stack.dtype}: {one}",)


def _bytes(picture: NDArray[Any], white: float) -> Image:
    if picture.dtype == np.uint8:
        return freeze(np.ascontiguousarray(picture))
    return freeze(np.clip(np.rint(picture * white), 0, 255).astype(np.uint8))
