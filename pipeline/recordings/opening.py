"""One way in for every kind of recording: what it is decides its content, not only its name."""

from __future__ import annotations

from pathlib import Path

from pipeline.errors import FileProblem
from pipeline.frames import Recording
from pipeline.recordings import hdf5, images, overrides, pictures
from pipeline.recordings.hdf5_layout import SIGNATURE


def open_recording(path: Path, *, sensor: str = "", reference: Path | None = None) -> Recording:
    """The recording at `path`, a file or a folder; frames are read when they are asked for.

    `sensor` names the sensor where the file does not; `reference` is a picture of the untouched sensor. Raises
    FileProblem, SettingProblem or CalibrationError with what is wrong, where, and what to try.
    """
    path = Path(path)
    if not path.exists():
        raise FileProblem("no such file or folder", path)
    if path.is_dir():
        if not any(path.iterdir()):
            raise FileProblem("the folder is empty", path)
        return images.read(path, sensor=sensor, reference=reference)
    with path.open("rb") as file:
        head = file.read(16)
    if head.startswith(SIGNATURE):
        recording = overrides.with_sensor(hdf5.read(path), sensor)
        if reference is None:
            return recording
        return overrides.with_reference(recording, pictures.rgb(reference), reference)
    if pictures.is_picture(path):
        return images.read(path, sensor=sensor, reference=reference)
    raise FileProblem("this is no kind of recording that can be read", path)
