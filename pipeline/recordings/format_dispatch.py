"""One way in for every kind of recording: what it is decides its content, not only its name."""

from __future__ import annotations

import zipfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from pipeline.base.errors import FileProblem
from pipeline.base.files import describe_os_error, read_arrays, require_file
from pipeline.recordings import (
    colour_arrays,
    depth_arrays,
    gelslim_depth,
    hdf5,
    image_files,
    image_folder,
    overrides,
    point_clouds,
    torch_files,
    touch2touch,
    video,
)
from pipeline.recordings.depth_arrays import DepthUnit
from pipeline.recordings.folder_contents import PICKLE_REFUSAL, FolderContent, find_recording
from pipeline.recordings.hdf5_layout import SIGNATURE
from pipeline.recordings.mounts import open_mounted
from pipeline.values.frames import Recording

_KINDS = (
    "a tactoscope .h5, a folder of images, a video, .pt of touch2touch or gelslim_depth, or depth or pictures in .npz "
    "or .npy"
)


def open_recording(
    path: Path, *, sensor: str = "", reference: Path | None = None, depth_unit: DepthUnit = "auto"
) -> Recording:
    """The recording at `path`, a file or a folder; frames are read when they are asked for.

    `sensor` names the sensor where the file does not (of a single stream it counts more than what the file says),
    `reference` is a picture of the untouched sensor, `depth_unit` what depth arrays are in when their names do not
    tell. Raises FileProblem, SettingProblem or CalibrationError with what is wrong, where, and what to try.
    """
    path = Path(path)
    held = open_mounted(path)
    if held is not None:
        return _said(held, sensor, reference, depth_unit)
    try:
        path.stat()
    except (OSError, ValueError) as error:
        raise FileProblem(f"no such file or folder ({describe_os_error(error)})", path) from error
    if reference is not None:
        require_file(reference, "the picture of the untouched sensor")
    try:
        found = find_recording(path) if path.is_dir() else _file(path)
        return _read(path, found, sensor, reference, depth_unit)
    except OSError as error:
        raise FileProblem(f"cannot read the recording ({describe_os_error(error)})", path) from error


def _read(path: Path, found: FolderContent, sensor: str, reference: Path | None, unit: DepthUnit) -> Recording:
    match found.kind:
        case "images" if _is_depth(found.images):
            return depth_arrays.read_image_folder(path, found, sensor=sensor, reference=reference, unit=unit)
        case "images":
            return image_folder.read(path, found, sensor=sensor, reference=reference)
        case "point_clouds":
            recording = point_clouds.read(found.path, sensor=sensor)
        case "samples":
            recording = touch2touch.read_folder(found.path)
        case "file":
            return _with(found.notes, _read_file(found.path, sensor, reference, unit))
    return _with(found.notes, _said(recording, sensor, reference, unit))


def _read_file(path: Path, sensor: str, reference: Path | None, unit: DepthUnit) -> Recording:
    match _file_kind(path):
        case "video":
            return video.read(path, sensor=sensor, reference=reference)
        case "arrays":
            arrays = read_arrays(path, "the recording")
            if not any("depth" in k.lower() for k in arrays) and colour_arrays.find_colour_keys(arrays):
                return colour_arrays.read(path, arrays, sensor=sensor, reference=reference)
            return depth_arrays.read(path, arrays, sensor=sensor, reference=reference, unit=unit)
        case "hdf5":
            recording = hdf5.read(path)
        case "torch":
            recording = _torch_recording(path)
        case _:
            raise FileProblem(f"this is no kind of recording that can be read; known are {_KINDS}", path)
    return _said(recording, sensor, reference, unit)


def _with(notes: tuple[str, ...], recording: Recording) -> Recording:
    return replace(recording, notes=(*notes, *recording.notes))


def _said(recording: Recording, sensor: str, reference: Path | None, unit: DepthUnit) -> Recording:
    try:
        return _as_said(recording, sensor, reference, unit)
    except Exception:
        recording.close()
        raise


def _as_said(recording: Recording, sensor: str, reference: Path | None, depth_unit: DepthUnit) -> Recording:
    recording = overrides.with_sensor(recording, sensor)
    if reference is None:
        return recording
    is_depth = not image_files.is_image_file(reference) or image_files.read_raw_pixels(reference).dtype == np.uint16
    untouched = depth_arrays.read_depth_image(reference, depth_unit) if is_depth else image_files.read_rgb(reference)
    return overrides.with_reference(recording, untouched, reference)


def _torch_recording(path: Path) -> Recording:
    found = torch_files.load_tensors(path)
    if touch2touch.is_sample(found):
        return touch2touch.read(path)
    if gelslim_depth.is_dictionary(found):
        return gelslim_depth.read(path)
    keys = ", ".join(sorted(map(str, found))) or "nothing"
    raise FileProblem(f"the file is neither of touch2touch nor of gelslim_depth; its keys are {keys}", path)


def _is_depth(files: Sequence[Path]) -> bool:
    """Whether the first picture that can be read has one channel of 16 bits."""
    for file in files:
        try:
            pixels = image_files.read_raw_pixels(file)
        except FileProblem:
            continue
        return pixels.dtype == np.uint16 and pixels.ndim == 2
    return False


def _file(path: Path) -> FolderContent:
    """A picture is a folder of one."""
    if _file_kind(path) == "images":
        return FolderContent(kind="images", path=path, images=(path,))
    return FolderContent(kind="file", path=path)


def _file_kind(path: Path) -> str:
    """By the first bytes; only legacy PyTorch files and videos are known by their names."""
    require_file(path, "the recording", most_bytes=1 << 50)
    with path.open("rb") as file:
        head = file.read(16)
    suffix = path.suffix.lower()
    if not head:
        raise FileProblem("the file is empty", path)
    if head.startswith(SIGNATURE):
        return "hdf5"
    if suffix in (".h5", ".hdf5"):
        raise FileProblem("this is not an HDF5 file, or its beginning is damaged", path)
    if head.startswith(b"\x93NUMPY") or suffix in (".npz", ".npy"):
        return "arrays"
    if head.startswith(b"PK\x03\x04") and suffix not in (".pt", ".pth"):
        return _zip_kind(path)
    if suffix in (".pt", ".pth"):
        return "torch"
    if suffix in (".pkl", ".pickle"):
        raise FileProblem(PICKLE_REFUSAL, path)
    if image_files.is_image_file(path):
        return "images"
    return "video" if suffix in video.VIDEO_SUFFIXES else ""


def _zip_kind(path: Path) -> str:
    try:
        with zipfile.ZipFile(path) as archive:
            return "torch" if any(n.endswith("/data.pkl") for n in archive.namelist()) else "arrays"
    except zipfile.BadZipFile as error:
        raise FileProblem("the file is cut short or damaged", path) from error
