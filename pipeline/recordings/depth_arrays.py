"""Depth images of a bubble as arrays: `.npz` of Punyo and the like, `.npy`, or a folder of 16-bit images.

The unit must be told by the key (or the file's name): depth_mm, depth_m, depth_um, depth_u16_0p1mm. Nothing is guessed.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Floats, freeze
from pipeline.base.errors import CalibrationError, FileProblem
from pipeline.base.files import read_arrays
from pipeline.base.text import escape_text
from pipeline.geometry.camera import Camera, make_camera
from pipeline.recordings import image_files, resampling
from pipeline.recordings.folder_contents import FolderContent
from pipeline.recordings.index_check import with_index_check
from pipeline.recordings.sensor_guess import resolve_sensor_name
from pipeline.sensors.spec import load_sensor as sensor_spec
from pipeline.values.frames import Recording, Stream, TactileFrame

DepthUnit = Literal["auto", "mm", "m", "0.1mm", "um"]
_MM_PER_UNIT: Mapping[str, float] = {"mm": 1.0, "m": 1000.0, "0.1mm": 0.1, "um": 0.001}
_TOLD = re.compile(r"_(?P<unit>0p1mm|mm|um|m)$", re.IGNORECASE)
_PLAUSIBLE_MM = (5.0, 2000.0)  # a tactile depth camera looks at a membrane some centimetres away
_N_UNTOUCHED = 5  # first frames whose median is taken as untouched: a fifth of the noise of one


def read(
    path: Path,
    arrays: Mapping[str, NDArray[Any]],
    *,
    sensor: str = "",
    reference: Path | None = None,
    unit: DepthUnit = "auto",
) -> Recording:
    """One stream of float32 depth in mm, NaN where there is no reading (0, negative, 65535, not finite).

    Without `reference` (another depth file) the median of the first frames is taken as untouched, and noted. Raises
    FileProblem when the array cannot be read or its unit is not told.
    """  # fmt: skip
    return _recording(path, _arrays(path, arrays, unit), sensor, reference, unit)


def read_image_folder(
    path: Path, found: FolderContent, *, sensor: str = "", reference: Path | None = None, unit: DepthUnit = "auto"
) -> Recording:
    """The same of 16-bit images; one that is named as untouched is the reference where none is given."""
    files = [p for p in found.images if p != reference]
    if not files:
        raise FileProblem("the only depth image is the reference", path)
    named = path.stem if path.is_file() else path.name
    if unit == "auto" and _TOLD.search(named) is None and _TOLD.search(files[0].stem) is not None:
        named = files[0].stem
    told = _unit_of(named, unit, path)
    loaded = _Loaded(named, told, len(files), lambda i: _sixteen_bit(files[i]), path)
    loaded.notes = found.notes
    reference = reference or (found.references[0] if found.references else None)
    return _recording(path, loaded, sensor, reference, cast("DepthUnit", told))


def _recording(path: Path, loaded: _Loaded, sensor: str, reference: Path | None, unit: DepthUnit) -> Recording:
    n, first = loaded.n_frames, loaded.depth_mm(0)
    shape = cast("tuple[int, int]", first.shape)
    name, notes = resolve_sensor_name(sensor, shape, is_depth=True)
    camera = loaded.camera
    if camera is None:
        camera, about_camera = resampling.infer_depth_camera(sensor_spec(sensor or name), shape)
        notes += about_camera
    untouched: Floats | None = None
    if reference is not None:
        untouched, about = read_depth_image(reference, unit), f"{reference.name} shows the untouched sensor"
    elif n > 1:
        n_first = min(_N_UNTOUCHED, max(1, n // 6))
        untouched = compute_median_depth(np.stack([loaded.depth_mm(i) for i in range(n_first)]))
        about = describe_first_frames(n_first)
    else:
        about = "one picture alone has nothing to be compared to; name one of the untouched sensor with --reference"
    if untouched is not None and untouched.shape != shape:
        assert reference is not None
        raise FileProblem(f"the reference has shape {untouched.shape}, the frames {first.shape}", reference)

    def frame(index: int) -> TactileFrame:
        return TactileFrame(sensor=name, image=loaded.depth_mm(index), reference=untouched, index=index,
                            time_s=float(loaded.times_s[index]), origin=f"{path} [{loaded.key} {index}]",
                            camera=camera)  # fmt: skip

    stream = Stream(name=name, sensor=name, n_frames=n, frame=with_index_check(frame, n, path))
    notes = (*notes, escape_text(f"{loaded.key} is taken as {loaded.unit}"), about, *loaded.notes)
    return Recording(path=path, format="depth arrays", streams=(stream,), notes=notes)


def describe_first_frames(n: int) -> str:
    """What is said of a reference that is the median of the first `n` frames."""
    first = "the first frame" if n == 1 else f"the median of the first {n} frames"
    return f"{first} is taken as the untouched sensor"


def read_depth_image(path: Path, unit: DepthUnit = "auto") -> Floats:
    """One depth image in mm: the median over all images of an array file, or one 16-bit picture."""
    if image_files.is_image_file(path):
        return _in_mm(_sixteen_bit(path), _unit_of(path.stem, unit, path), path.name, path)
    loaded = _arrays(path, read_arrays(path, "the depth images"), unit)
    return compute_median_depth(np.stack([loaded.depth_mm(i) for i in range(loaded.n_frames)]))


class _Loaded:
    """Depth images behind one face, wherever they come from."""

    def __init__(self, key: str, unit: str, n_frames: int, read_raw: Callable[[int], NDArray[Any]], path: Path) -> None:
        self.key, self.unit, self.n_frames, self._read_raw, self._path = key, unit, n_frames, read_raw, path
        self.times_s: NDArray[Any] = np.full(n_frames, np.nan)
        self.camera: Camera | None = None
        self.notes: tuple[str, ...] = ()

    def depth_mm(self, index: int) -> Floats:
        return _in_mm(self._read_raw(index), self.unit, f"{self.key} of frame {index}", self._path)


def _arrays(path: Path, arrays: Mapping[str, NDArray[Any]], unit: DepthUnit) -> _Loaded:
    key = _depth_key(arrays, path)
    told, stack = _unit_of(key, unit, path), arrays[key]
    stack = stack[None] if stack.ndim == 2 else stack
    stack = stack[..., 0] if stack.ndim == 4 and stack.shape[-1] == 1 else stack
    if stack.dtype.kind not in "fiu" or stack.dtype.itemsize > 8:
        raise FileProblem(f"{key} must hold real numbers, got {stack.dtype}", path, field=key)
    if stack.ndim != 3 or not stack.size:
        raise FileProblem(f"{key} must have shape (frames, rows, cols), got {arrays[key].shape}", path, field=key)
    loaded = _Loaded(key, told, len(stack), lambda i: stack[i], path)  # pyright: ignore[reportUnknownLambdaType]
    if "K" in arrays:
        if arrays["K"].dtype.kind not in "fiu":
            raise FileProblem(f"K must hold real numbers, got {arrays['K'].dtype}", path, field="K")
        try:
            loaded.camera = make_camera(arrays["K"], stack.shape[1], stack.shape[2], what="K")
        except CalibrationError as error:
            raise CalibrationError(f"{error}: '{path}'") from error
    for name in ("timestamps_s", "time_s", "t_s"):
        if name in arrays and arrays[name].shape == (len(stack),) and arrays[name].dtype.kind in "fiu":
            loaded.times_s = arrays[name]
    left = sorted(arrays.keys() - {key, "K", "timestamps_s", "time_s", "t_s", "frame"})
    loaded.notes = (f"also in the file and left out: {escape_text(', '.join(left))}",) if left else ()
    return loaded


def _sixteen_bit(file: Path) -> NDArray[Any]:
    pixels = image_files.read_raw_pixels(file)
    if pixels.ndim != 2 or pixels.dtype != np.uint16:
        raise FileProblem("a depth image must have one channel of 16 bits", file)
    return pixels


def _depth_key(arrays: Mapping[str, NDArray[Any]], path: Path) -> str:
    candidates = [k for k, a in arrays.items() if a.ndim >= 2 and a.shape != (3, 3) and k != "K"]
    named = [k for k in candidates if "depth" in k.lower()] or candidates
    if len(named) != 1:
        seen = ", ".join(f"{k} {a.shape}" for k, a in arrays.items()) or "nothing"
        raise FileProblem(f"cannot tell which array is the depth, looked at {seen}; name one depth_mm or depth_m", path)
    return named[0]


def _unit_of(key: str, said: DepthUnit, path: Path) -> str:
    if said != "auto":
        return said
    match = _TOLD.search(key)
    if match is None:
        raise FileProblem(
            f"cannot tell the unit of {key!r}; name it {key}_mm or {key}_m, or give --depth-unit", path, field=key
        )
    return match["unit"].lower().replace("0p1mm", "0.1mm")


def _in_mm(raw: NDArray[Any], unit: str, what: str, path: Path) -> Floats:
    values = raw.astype(np.float32) * np.float32(_MM_PER_UNIT[unit])
    gaps = ~np.isfinite(values) | (raw <= 0) | ((raw == 65535) if raw.dtype == np.uint16 else False)
    values[gaps] = np.nan
    if not gaps.all():
        typical = float(np.median(values[~gaps]))
        if not _PLAUSIBLE_MM[0] <= typical <= _PLAUSIBLE_MM[1]:
            raise FileProblem(f"{what} would have a median of {typical:.3g} mm when read in {unit}; is that its unit?",
                              path, field=what)  # fmt: skip
    return freeze(values)


def compute_median_depth(stack: NDArray[Any]) -> Floats:
    """Of depth images (frames, rows, cols), NaN only where no frame has a reading."""
    seen = np.isfinite(stack).any(axis=0)
    median = np.full(stack.shape[1:], np.nan, np.float32)
    median[seen] = np.nanmedian(stack[:, seen], axis=0)
    return freeze(median)
