"""Images of a gel as `.npy` or `.npz` arrays: bytes, floats of 0 to 1 or 0 to 255, or signed differences."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Image, freeze
from pipeline.base.errors import FileProblem, escape_text
from pipeline.base.files import read_arrays
from pipeline.recordings import image_files
from pipeline.recordings.formats import ReadOptions, RecordingFiles, with_index_check
from pipeline.recordings.gel_images import make_gel_converter
from pipeline.values.frames import Recording, Stream, TactileFrame

_MIN_SIDE_PX = 8  # of an image; smaller arrays with three columns are points or matrices
_WHITE = 255.0  # grey level


def is_colour_file(files: RecordingFiles) -> bool:
    """Whether the arrays hold colour images and none is named depth; raises FileProblem."""
    arrays = read_arrays(files.path, "the recording")
    return not any("depth" in key.lower() for key in arrays) and bool(_find_colour_keys(arrays))


def read(files: RecordingFiles, options: ReadOptions) -> Recording:
    """One stream of RGB frames. The reference is `options.reference`, else an array whose name says so.

    Signed numbers are differences from the reference, which they imply. Raises FileProblem or SettingProblem.
    """
    path, arrays = files.path, read_arrays(files.path, "the recording")
    colour_keys = _find_colour_keys(arrays)
    reference_keys = [k for k in colour_keys if image_files.is_reference_key(k)]
    frame_keys = [k for k in colour_keys if k not in reference_keys]
    if len(frame_keys) != 1:
        shapes = ", ".join(f"{k} {arrays[k].shape}" for k in colour_keys)
        raise FileProblem(f"cannot tell which array holds the frames ({shapes}); keep one in the file", path)
    key = frame_keys[0]
    stack = _arrange_frames(arrays[key])
    scale, notes = _infer_scale(stack, key, path)
    reference, about = None, ()
    if options.reference is not None:
        reference, about = image_files.read_rgb(options.reference), (f"{options.reference.name} is the reference",)
    elif reference_keys:
        base = _arrange_frames(arrays[reference_keys[0]])
        reference = _convert_to_bytes(base[0], _infer_scale(base, reference_keys[0], path)[0])
        about = (f"{escape_text(reference_keys[0])} is the reference",)
    shape = (int(stack.shape[1]), int(stack.shape[2]))
    if reference is not None and reference.shape[:2] != shape:
        raise FileProblem(f"the reference has shape {reference.shape}, the frames {stack.shape[1:]}", path)
    is_signed = scale < 0
    if is_signed and reference is not None:
        raise FileProblem(f"{key} holds differences, which need no reference; leave it out", path, field=key)

    def read_raw(index: int) -> NDArray[np.generic]:
        if is_signed:
            return (stack[index] * np.float32(-scale)).astype(np.float32)
        return _convert_to_bytes(stack[index], scale)

    converter = make_gel_converter(options.sensor, shape, reference, lambda: read_raw(0))
    if converter.reference is None:
        about = (image_files.NO_REFERENCE_NOTE,)

    def frame(index: int) -> TactileFrame:
        return TactileFrame(sensor=converter.sensor, image=converter.convert_image(read_raw(index)), index=index,
                            reference=converter.reference, origin=f"{path} [{key} {index}]")  # fmt: skip

    stream = Stream(name=converter.sensor or "images", sensor=converter.sensor, n_frames=len(stack),
                    frame=with_index_check(frame, len(stack), path))  # fmt: skip
    notes = (*files.notes, *converter.notes, *notes, *about)
    return Recording(path=path, format="colour arrays", streams=(stream,), notes=notes)


def _find_colour_keys(arrays: Mapping[str, NDArray[Any]]) -> tuple[str, ...]:
    """Keys of arrays that hold colour images (..., rows, cols, 3) or (..., 3, rows, cols)."""
    return tuple(
        k for k, a in arrays.items() if a.ndim in (3, 4) and a.dtype.kind in "fiu" and _find_colour_axis(a) is not None
    )


def _find_colour_axis(array: NDArray[Any]) -> int | None:
    """The axis of the three colours: last (-1), or before rows and columns (-3)."""
    for axis, sides in ((-1, array.shape[-3:-1]), (-3, array.shape[-2:])):
        if array.shape[axis] == 3 and min(sides) >= _MIN_SIDE_PX:
            return axis
    return None


def _arrange_frames(array: NDArray[Any]) -> NDArray[Any]:
    """(frames, rows, cols, 3); a view, so that a mapped file stays mapped."""
    colours_last = array if _find_colour_axis(array) == -1 else np.moveaxis(array, -3, -1)
    return colours_last if colours_last.ndim == 4 else colours_last[None]


def _infer_scale(stack: NDArray[Any], key: str, path: Path) -> tuple[float, tuple[str, ...]]:
    """(factor from stored values to grey levels 0..255, notes); the factor is negative for signed differences."""
    if not stack.size:
        raise FileProblem(f"{key} holds no frame", path, field=key)
    if stack.dtype == np.uint8:
        return 1.0, ()
    low, high = float(np.min(stack)), float(np.max(stack))
    if not np.isfinite([low, high]).all():
        raise FileProblem(f"{key} has values that are not finite", path, field=key)
    largest = max(-low, high)
    if largest > _WHITE + 0.5:
        raise FileProblem(
            f"{key} must hold grey levels of 0 to 255, or 0 to 1, got {low:g} to {high:g}", path, field=key
        )
    scale, white = (_WHITE, "1 is white") if largest <= 1.0 else (1.0, "255 is white")
    if low < 0:
        return -scale, (f"{escape_text(key)} has negative values: {white}, and 0 is no change",)
    return scale, (f"{escape_text(key)} holds {stack.dtype}: {white}",)


def _convert_to_bytes(image: NDArray[Any], scale: float) -> Image:
    if image.dtype == np.uint8:
        return freeze(np.ascontiguousarray(image))
    return freeze(np.clip(np.rint(image * scale), 0, 255).astype(np.uint8))
