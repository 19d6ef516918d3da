"""Depth images of a bubble: `.npz` of Punyo and the like, `.npy`, or a folder of 16-bit images.

The name of the array (or file) states the unit: depth_mm, depth_m, depth_um, depth_u16_0p1mm. No
unit is guessed.
"""

from __future__ import annotations

import contextlib
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from pipeline.core.arrays import Doubles, Floats, Stored, freeze
from pipeline.core.errors import FileProblem, escape_text, naming_file
from pipeline.core.files import read_arrays
from pipeline.core.frozen import frozen
from pipeline.core.geometry.camera import Camera, make_camera
from pipeline.core.values.frames import Recording, Stream, TactileFrame
from pipeline.io import file_names, image_files, resampling, stored_arrays
from pipeline.io.formats import DepthUnit, ReadOptions, RecordingFiles, with_index_check
from pipeline.io.sensor_guess import resolve_sensor_name
from pipeline.sensors.spec import SensorSpec, describe_unit_problem, find_unit_factor, load_sensor

_MM_PER_UNIT: Mapping[str, float] = {"mm": 1.0, "m": 1000.0, "0.1mm": 0.1, "um": 0.001}
_UNIT_SUFFIX = re.compile(
    r"(?:^(?!m$)|_)(?P<unit>0[p.]1mm|mm|um|m)$", re.IGNORECASE
)  # or the whole name, as of a folder
# to the rest depth within which a unit is suggested: steps of 0.25 mm are no tenths
_MAX_RATIO = 1.6
# range of a median depth: the camera is some centimetres from the membrane
_PLAUSIBLE_MM = (5.0, 2000.0)
# first frames whose median is the reference: its noise is half of that of one frame
_N_REFERENCE_FRAMES = 5
_TIME_KEYS = ("timestamps_s", "time_s", "t_s")


def are_depth_images(files: RecordingFiles) -> bool:
    """Whether the first image that can be read is a depth image."""
    for file in files.images:
        with contextlib.suppress(FileProblem):
            return is_depth_image(file)
    return False


def is_depth_image(file: Path) -> bool:
    """Whether an image has one channel of 16 bits or of floats.

    Raises FileProblem where it cannot be read.
    """
    return _holds_depth(image_files.read_raw_pixels(file))


def _holds_depth(pixels: Stored) -> bool:
    return pixels.ndim == 2 and (pixels.dtype == np.uint16 or pixels.dtype.kind == "f")


def read(files: RecordingFiles, options: ReadOptions) -> Recording:
    """One stream of float32 depth in mm; NaN where the value is 0, negative, 65535 or not finite.

    The reference is `options.reference` (another depth file), else the median of the first frames,
    with a note. Raises FileProblem for an array that cannot be read or whose unit is not stated.
    """
    arrays = read_arrays(files.path, "the recording")
    return _make_recording(files, _stack_arrays(files.path, arrays, options), options)


def read_image_folder(files: RecordingFiles, options: ReadOptions) -> Recording:
    """As `read`, from 16-bit images.

    An image whose name says so is the reference where none is given.
    """
    images = [p for p in files.images if p != options.reference]
    if not images:
        raise FileProblem("the only depth image is the reference", files.path)
    names = [images[0].stem]
    if files.path.is_dir():
        names = [files.path.name, *names, images[0].parent.name]
    return _read_files(files, options, images, names, _read_depth_pixels)


def read_array_folder(
    files: RecordingFiles, options: ReadOptions, read_array: Callable[[Path], NDArray[Any]]
) -> Recording:
    """As `read`, from a folder with one array a frame, whose name or that of the folder states
    the unit.
    """

    def read_image(file: Path) -> NDArray[Any]:
        (image,) = _check_images(read_array(file), file.stem, file)
        return image

    names = [files.path.name, files.images[0].stem]
    return _read_files(files, options, files.images, names, read_image)


def _read_files(
    files: RecordingFiles,
    options: ReadOptions,
    images: Sequence[Path],
    names: Sequence[str],
    read_image: Callable[[Path], NDArray[Any]],
) -> Recording:
    """One depth image a file; the first of the `names` that has a unit states it."""
    key = next((n for n in names if _UNIT_SUFFIX.search(n)), names[-1])
    unit = _resolve_unit(
        key, options.depth_unit, files.path, lambda: read_image(images[0]), options.sensor
    )
    stack = _DepthStack(
        key=key,
        unit=unit,
        n_frames=len(images),
        read_raw=lambda index: read_image(images[index]),
        path=files.path,
        times_s=file_names.parse_times_s(images),
    )
    reference = options.reference or next(iter(files.references), None)
    options = replace(options, reference=reference, depth_unit=cast("DepthUnit", unit))
    return _make_recording(files, stack, options)


def _make_recording(files: RecordingFiles, stack: _DepthStack, options: ReadOptions) -> Recording:
    path = files.path
    n = stack.n_frames
    first = stack.depth_mm(0)
    shape = cast("tuple[int, int]", first.shape)
    name, notes = resolve_sensor_name(options.sensor, shape, is_depth=True)
    spec = load_sensor(options.sensor or name)
    _check_unit(stack, first, spec)
    camera = stack.camera
    if camera is None:
        camera, camera_notes = resampling.infer_depth_camera(spec, shape)
        notes += camera_notes
    reference: Floats | None = None
    if options.reference is not None:
        reference = read_depth_image(options.reference, options.depth_unit)
        about = f"{options.reference.name} is the reference"
        if reference.shape != shape:
            raise FileProblem(
                f"the reference has shape {reference.shape}, the frames {shape}", options.reference
            )
        problem = describe_unit_problem(_compute_median(reference), spec)
        if problem:
            raise FileProblem(
                f"the reference {problem}; convert it to that of the frames", options.reference
            )
    elif n > 1:
        n_first = min(_N_REFERENCE_FRAMES, max(1, n // 6))
        which = "the first frame" if n_first == 1 else f"the median of the first {n_first} frames"
        about = f"{which} is taken as the reference"
        reference = compute_median_depth(np.stack([stack.depth_mm(i) for i in range(n_first)]))
    else:
        about = "one depth image has no reference; name one with --reference"

    def frame(index: int) -> TactileFrame:
        return TactileFrame(
            sensor=name,
            image=stack.depth_mm(index),
            reference=reference,
            index=index,
            time_s=math.nan if stack.times_s is None else float(stack.times_s[index]),
            origin=f"{path} [{stack.key} {index}]",
            camera=camera,
        )

    stream = Stream(
        name=name,
        sensor=name,
        n_frames=n,
        frame=with_index_check(frame, n, path),
        times_s=stack.times_s,
    )
    unit = escape_text(f"{stack.key} is taken as {stack.unit}")
    notes = (*notes, unit, about, *stack.notes)
    return Recording(path=path, format="depth arrays", streams=(stream,), notes=notes)


def _check_unit(stack: _DepthStack, first: Floats, spec: SensorSpec) -> None:
    """Raise FileProblem where another unit brings the depth to the membrane's, and the stated
    one does not.
    """
    depth_mm = _compute_median(first)
    problem = describe_unit_problem(depth_mm, spec)
    if problem:
        raw = depth_mm / _MM_PER_UNIT[stack.unit]
        fits = _list_units(raw, lambda mm: find_unit_factor(mm, spec) == 1.0)
        remedy = f"give --depth-unit {fits[0]}" if fits else "convert it to mm"
        raise FileProblem(f"{stack.key}, read in {stack.unit}, {problem}; {remedy}", stack.path)


def _list_units(raw: float, fits: Callable[[float], bool]) -> list[str]:
    """The units in which a stored depth is in millimetres as `fits` wants it."""
    return [unit for unit, mm in _MM_PER_UNIT.items() if fits(raw * mm)]


def _compute_median(depth: NDArray[Any]) -> float:
    """The median of the values of a depth image; NaN where it has none."""
    known = depth[np.isfinite(depth) & (depth > 0)]
    return float(np.median(known)) if known.size else math.nan


def read_depth_image(path: Path, unit: DepthUnit = "auto") -> Floats:
    """One depth image in mm: the median over all images of an array file, or one 16-bit image."""
    if image_files.is_image_file(path):
        pixels = _read_depth_pixels(path)
        return _convert_to_mm(
            pixels, _resolve_unit(path.stem, unit, path, lambda: pixels), path.name, path
        )
    stack = _stack_arrays(path, read_arrays(path, "the depth images"), ReadOptions(depth_unit=unit))
    return compute_median_depth(np.stack([stack.depth_mm(i) for i in range(stack.n_frames)]))


@frozen
class _DepthStack:
    """Depth images of one file or folder, read on demand."""

    key: str
    unit: str
    n_frames: int
    read_raw: Callable[[int], NDArray[Any]]
    path: Path
    times_s: Doubles | None = None
    camera: Camera | None = None
    notes: tuple[str, ...] = ()

    def depth_mm(self, index: int) -> Floats:
        """One image (rows, cols) in mm."""
        what = f"{self.key} of frame {index}"
        return _convert_to_mm(self.read_raw(index), self.unit, what, self.path)


def _stack_arrays(
    path: Path, arrays: Mapping[str, NDArray[Any]], options: ReadOptions
) -> _DepthStack:
    key = _find_depth_key(arrays, path)
    images = _check_images(arrays[key], key, path)
    camera = None
    k = arrays.get("K")
    if k is not None:
        if k.dtype.kind not in "fiu":
            raise FileProblem(f"K must hold real numbers, got {k.dtype}", path)
        with naming_file(path):
            camera = make_camera(k, images.shape[1], images.shape[2], what="K")
    unused = escape_text(", ".join(sorted(arrays.keys() - {key, "K", "frame", *_TIME_KEYS})))
    return _DepthStack(
        key=key,
        unit=_resolve_unit(key, options.depth_unit, path, lambda: images[0], options.sensor),
        n_frames=len(images),
        read_raw=lambda index: images[index],  # pyright: ignore[reportUnknownLambdaType]
        path=path,
        times_s=find_times(arrays, len(images)),
        camera=camera,
        notes=(f"other arrays of the file are left out: {unused}",) if unused else (),
    )


def find_times(arrays: Mapping[str, NDArray[Any]], n_frames: int) -> Doubles | None:
    """The times in seconds (n_frames,) among arrays; None where none holds them."""
    for name in _TIME_KEYS:
        times = arrays.get(name)
        if times is not None and times.shape == (n_frames,) and times.dtype.kind in "fiu":
            return freeze(times.astype(np.float64))
    return None


def _check_images(array: NDArray[Any], key: str, path: Path) -> NDArray[Any]:
    """Depth images (frames, rows, cols) of an array that may lack the first axis or have a last
    one of length 1.
    """
    images = array[None] if array.ndim == 2 else array
    images = images[..., 0] if images.ndim == 4 and images.shape[-1] == 1 else images
    if stored_arrays.is_grey(images):
        raise FileProblem(
            f"{key} holds {images.dtype}, which is too coarse for depth: these are grey images or "
            "masks, "
            "and a gel's depth is read from colour images",
            path,
        )
    if images.dtype.kind not in "fiu" or images.dtype.itemsize > 8:
        raise FileProblem(f"{key} must hold real numbers, got {images.dtype}", path)
    if images.ndim != 3 or not images.size:
        raise FileProblem(f"{key} must have shape (frames, rows, cols), got {array.shape}", path)
    return images


def _read_depth_pixels(file: Path) -> NDArray[Any]:
    pixels = image_files.read_raw_pixels(file)
    if not _holds_depth(pixels):
        raise FileProblem("a depth image must have one channel of 16 bits or of floats", file)
    return pixels


def _find_depth_key(arrays: Mapping[str, NDArray[Any]], path: Path) -> str:
    candidates = [k for k, a in arrays.items() if a.ndim >= 2 and a.shape != (3, 3) and k != "K"]
    candidates = [k for k in candidates if "depth" in k.lower()] or candidates
    if not any(array.size for array in arrays.values()):
        raise FileProblem("the arrays of the file are empty", path)
    if len(candidates) != 1:
        shapes = ", ".join(f"{k} {a.shape}" for k, a in arrays.items()) or "none"
        raise FileProblem(
            f"cannot tell which array is the depth ({shapes}); name one depth_mm or depth_m", path
        )
    return candidates[0]


def _resolve_unit(
    key: str, stated: DepthUnit, path: Path, read: Callable[[], NDArray[Any]], sensor: str = ""
) -> str:
    """The stated unit, or that of the name `key`.

    Raises FileProblem with the one that fits where none is stated.
    """
    if stated != "auto":
        return stated
    match = _UNIT_SUFFIX.search(key)
    if match is None:
        name = f"name it {key}_mm, {key}_m, {key}_um or {key}_0p1mm"
        raise FileProblem(
            f"cannot tell the unit of {key!r}; {_suggest_unit(read(), sensor)}, or {name}",
            path,
        )
    return match["unit"].lower().replace("0p1mm", "0.1mm")


def _suggest_unit(raw: NDArray[Any], sensor: str) -> str:
    """What to give as --depth-unit: the unit that brings a depth image as stored to the membrane
    of its sensor.
    """
    sensor = sensor or resolve_sensor_name("", raw.shape[:2], is_depth=True)[0]
    spec = load_sensor(sensor)
    rest_mm = float(np.median(spec.rest_depth_mm))
    fits = _list_units(
        _compute_median(raw), lambda mm: abs(math.log(mm / rest_mm)) < math.log(_MAX_RATIO)
    )
    if not fits:
        return "give --depth-unit"
    return f"give --depth-unit {fits[0]}, which fits the membrane of {spec.name}"


def _convert_to_mm(raw: NDArray[Any], unit: str, what: str, path: Path) -> Floats:
    """Depth in mm, NaN where `raw` has no value.

    Raises FileProblem for a median beyond `_PLAUSIBLE_MM`.
    """
    depth_mm = raw.astype(np.float32) * np.float32(_MM_PER_UNIT[unit])
    depth_mm[~np.isfinite(depth_mm) | (raw <= 0)] = np.nan
    if raw.dtype == np.uint16:
        depth_mm[raw == 65535] = np.nan
    median = _compute_median(depth_mm)
    low, high = _PLAUSIBLE_MM
    if median < low or median > high:
        fits = _list_units(median / _MM_PER_UNIT[unit], lambda mm: low <= mm <= high)
        remedy = f"; give --depth-unit {' or '.join(fits)}" if fits else ""
        raise FileProblem(
            f"{what} has a median of {median:.3g} mm when read in {unit}; check the unit{remedy}",
            path,
        )
    return freeze(depth_mm)


def compute_median_depth(stack: NDArray[Any]) -> Floats:
    """The median (rows, cols) of depth images (frames, rows, cols).

    NaN only where no frame has a value.
    """
    known = np.isfinite(stack).any(axis=0)
    median = np.full(stack.shape[1:], np.nan, np.float32)
    median[known] = np.nanmedian(stack[:, known], axis=0)
    return freeze(median)
