"""Touches of TacQuad: one object's folder with a folder of images for each of its sensors.

`contact_indoor.csv` and `contact_outdoor.csv` two levels above list first and last frame in
contact: object, then both numbers for GelSight Mini, DIGIT and DuraGel. The sensors touched one
after the other, so frames of two streams are paired by their share of the contact.
"""

import csv
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from pipeline.core.errors import FileProblem, StageWarning
from pipeline.core.files import MOST_TEXT_BYTES, read_bytes
from pipeline.core.values.frames import Recording, Stream, TactileFrame
from pipeline.io import image_folder
from pipeline.io.file_names import sort_series
from pipeline.io.formats import ReadOptions, RecordingFiles
from pipeline.io.image_files import is_image_file

# folder -> description, in the order of the tables
_SENSORS = {"gelsight": "gelsight_mini", "digit": "digit"}
_OTHERS = ("duragel", "tac3d")
_PAIRED = "the sensors touched one after the other; frames are paired by their share of the contact"


def is_touch_folder(folder: Path) -> bool:
    """Whether a folder holds one touch of several sensors."""
    return sum((folder / name).is_dir() for name in (*_SENSORS, *_OTHERS)) > 1 and any(
        _list_images(folder / name) for name in _SENSORS
    )


def read(path: Path) -> Recording:
    """The touch as streams of GelSight Mini and DIGIT; raises FileProblem."""
    streams = list[Stream]()
    notes = list[str]()
    unlisted = list[str]()
    ranges = _read_contact_ranges(path)
    for folder, sensor in _SENSORS.items():
        images = _list_images(path / folder)
        if images:
            files = RecordingFiles(path=path / folder, images=images)
            whole = image_folder.read(files, ReadOptions(sensor=sensor))
            numbers = [image.stem for image in images]
            first, last = (
                numbers.index(n) if n in numbers else -1 for n in ranges.get(folder, ("", ""))
            )
            is_listed = 0 <= first <= last
            indices = range(first, last + 1) if is_listed else range(len(images))
            unlisted += [] if is_listed else [sensor]
            streams.append(
                replace(
                    whole.streams[0],
                    name=sensor,
                    n_frames=len(indices),
                    times_s=None,
                    frame=_select_frames(whole.streams[0], indices),
                )
            )
            notes += [f"{sensor}: {note}" for note in whole.notes]
    n_frames = min(stream.n_frames for stream in streams)
    streams = [_resample(stream, n_frames) for stream in streams]
    if len(streams) > 1:
        notes.append(_warn_of_whole_films(unlisted) if unlisted else _PAIRED)
    left_out = [name for name in _OTHERS if (path / name).is_dir()]
    notes += (
        [f"sensors without a description are left out: {', '.join(left_out)}"] if left_out else []
    )
    return Recording(path=path, format="TacQuad touch", streams=tuple(streams), notes=tuple(notes))


def _warn_of_whole_films(sensors: list[str]) -> StageWarning:
    return StageWarning(
        "no contact_*.csv two folders above lists the first and last image in contact of "
        f"{' and '.join(sensors)}, so "
        "the whole film is taken: paired frames may show different moments; add the touch to the "
        "table"
    )


def _list_images(folder: Path) -> tuple[Path, ...]:
    return (
        tuple(sort_series(list(filter(is_image_file, folder.iterdir())))) if folder.is_dir() else ()
    )


def _read_contact_ranges(path: Path) -> dict[str, tuple[str, str]]:
    """Folder of a sensor -> names of the first and last image in contact.

    {} where no table lists the touch.
    """
    for file in sorted(path.parent.parent.glob("contact_*.csv")):
        text = read_bytes(file, "the table of contacts", MOST_TEXT_BYTES).decode(
            "utf-8", errors="replace"
        )
        try:
            for row in csv.reader(text.splitlines()):
                if row[:1] == [path.name] and len(row) > 2 * len(_SENSORS):
                    return {
                        name: (row[1 + 2 * k], row[2 + 2 * k]) for k, name in enumerate(_SENSORS)
                    }
        except csv.Error as error:
            raise FileProblem(f"the table of contacts cannot be read ({error})", file) from error
    return {}


def _resample(stream: Stream, n_frames: int) -> Stream:
    """The stream with `n_frames` frames spread evenly."""
    step = (stream.n_frames - 1) / max(1, n_frames - 1)
    indices = [round(k * step) for k in range(n_frames)]
    return replace(stream, n_frames=n_frames, frame=_select_frames(stream, indices))


def _select_frames(stream: Stream, indices: range | list[int]) -> Callable[[int], TactileFrame]:
    def frame(index: int) -> TactileFrame:
        inner = indices[index] if 0 <= index < len(indices) else stream.n_frames
        return replace(stream.frame(inner), index=index)

    return frame
