"""One way in for every kind of recording: what it is decides its content, not only its name."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np

from pipeline.base.errors import FileProblem
from pipeline.base.files import must_be_file, reason
from pipeline.recordings import (
    depth_arrays,
    gelslim_depth,
    hdf5,
    images,
    overrides,
    pictures,
    torch_files,
    touch2touch,
    video,
)
from pipeline.recordings.depth_arrays import DepthUnit
from pipeline.recordings.hdf5_layout import SIGNATURE
from pipeline.values.frames import Recording

_KINDS = "a tactoscope .h5, a folder of images, a video, .pt of touch2touch or gelslim_depth, or depth .npz or .npy"


def open_recording(
    path: Path, *, sensor: str = "", reference: Path | None = None, depth_unit: DepthUnit = "auto"
) -> Recording:
    """The recording at `path`, a file or a folder; frames are read when they are asked for.

    `sensor` names the sensor where the file does not (of a single stream it counts more than what the file says),
    `reference` is a picture of the untouched sensor, `depth_unit` what depth arrays are in when their names do not
    tell. Raises FileProblem, SettingProblem or CalibrationError with what is wrong, where, and what to try.
    """
    path = Path(path)
    try:
        path.stat()
    except (OSError, ValueError) as error:
        raise FileProblem(f"no such file or folder ({reason(error)})", path) from error
    if reference is not None:
        must_be_file(reference, "the picture of the untouched sensor")
    try:
        kind = _folder_kind(path) if path.is_dir() else _file_kind(path)
    except OSError as error:
        raise FileProblem(f"cannot read the recording ({reason(error)})", path) from error
    match kind:
        case "images":
            return images.read(path, sensor=sensor, reference=reference)
        case "video":
            return video.read(path, sensor=sensor, reference=reference)
        case "depth":
            return depth_arrays.read(path, sensor=sensor, reference=reference, unit=depth_unit)
        case "hdf5":
            recording = hdf5.read(path)
        case "samples":
            recording = touch2touch.read_folder(path)
        case "torch":
            recording = _torch_recording(path)
        case _:
            raise FileProblem(f"this is no kind of recording that can be read; known are {_KINDS}", path)
    try:
        return _as_said(recording, sensor, reference, depth_unit)
    except Exception:
        recording.close()
        raise


def _as_said(recording: Recording, sensor: str, reference: Path | None, depth_unit: DepthUnit) -> Recording:
    recording = overrides.with_sensor(recording, sensor)
    if reference is None:
        return recording
    is_depth = not pictures.is_picture(reference) or pictures.raw_pixels(reference).dtype == np.uint16
    untouched = depth_arrays.read_image(reference, depth_unit) if is_depth else pictures.rgb(reference)
    return overrides.with_reference(recording, untouched, reference)


def _torch_recording(path: Path) -> Recording:
    found = torch_files.tensors(path)
    if touch2touch.is_sample(found):
        return touch2touch.read(path)
    if gelslim_depth.is_dictionary(found):
        return gelslim_depth.read(path)
    keys = ", ".join(sorted(map(str, found))) or "nothing"
    raise FileProblem(f"the file is neither of touch2touch nor of gelslim_depth; its keys are {keys}", path)


def _folder_kind(path: Path) -> str:
    if not any(path.iterdir()):
        raise FileProblem("the folder is empty", path)
    shown = sorted(filter(pictures.is_picture, path.iterdir()), key=pictures.natural_key)
    if not shown:
        return "samples" if next(path.rglob("*.pt"), None) is not None else "images"
    for file in shown:
        try:
            pixels = pictures.raw_pixels(file)
        except FileProblem:
            continue
        return "depth" if pixels.dtype == np.uint16 and pixels.ndim == 2 else "images"
    return "images"


def _file_kind(path: Path) -> str:
    """By the first bytes; only legacy PyTorch files and videos are known by their names."""
    must_be_file(path, "the recording", most_bytes=1 << 50)
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
        return "depth"
    if head.startswith(b"PK\x03\x04") and suffix not in (".pt", ".pth"):
        return _zip_kind(path)
    if suffix in (".pt", ".pth"):
        return "torch"
    if suffix in (".pkl", ".pickle"):
        raise FileProblem("a pickle can run code when it is loaded and is refused; save its arrays as .npz", path)
    if pictures.is_picture(path):
        return "images"
    return "video" if suffix in video.SUFFIXES else ""


def _zip_kind(path: Path) -> str:
    try:
        with zipfile.ZipFile(path) as archive:
            return "torch" if any(n.endswith("/data.pkl") for n in archive.namelist()) else "depth"
    except zipfile.BadZipFile as error:
        raise FileProblem("the file is cut short or damaged", path) from error
