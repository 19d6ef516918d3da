"""Find the recording in a folder, or deeper in the tree of a data set.

Known trees: frames in a folder of their own (YCB-Slide, next to films and drawings), each press in
a folder of its own (calibrations of gs_sdk and gelslam), reference images in `bgs` (Sparsh).
Nothing is unpickled.
"""

import math
import re
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from pipeline.core.errors import FileProblem, escape_text
from pipeline.core.files import read_arrays
from pipeline.io.file_names import natural_sort_key, sort_series
from pipeline.io.formats import (
    RecordingFiles,
    explain_not_read,
    list_formats,
    list_suffixes,
)
from pipeline.io.image_files import is_image_file, is_reference_file
from pipeline.io.stored_arrays import find_colour_axis

PICKLE_SUFFIXES = frozenset({".pkl", ".pickle"})
PICKLE_REFUSAL = (
    "a pickle can run code when it is loaded and is refused: in the program that made it, save "
    "the images as PNG "
    "files, or the arrays with numpy.savez"
)
# hold a sensor's images, whatever lies next to them
_FRAME_FOLDERS = ("frames", "tactile_images")
_TACTILE_FOLDER = re.compile(r"tactile|touch|digit|gel|finger", re.IGNORECASE)
# no sensor's
_OTHER_FOLDERS = frozenset(
    {"webcam_frames", "gt_contactmasks", "gt_heightmaps", "obj_models", "bgs"}
)
# of YCB-Slide
_COMPANIONS = re.compile(r"^(tactile_data.*\.png|alignment\.npy|digit_data\.npy|synced_data\.npy)$")
_REFERENCE_FOLDER = "bgs"
_MESH_SUFFIXES = frozenset({".stl", ".obj"})
_MAX_LEVELS = 6  # folders below the one that was given
_MAX_NAMES = 3  # in a note
_MIN_SERIES = 2  # arrays of one image each, which are frames of one recording


def find_recording(folder: Path) -> RecordingFiles:
    """The files of the recording in `folder`.

    Raises FileProblem where there is none, and OSError.
    """
    at = folder
    notes = list[str]()
    references = list[Path]()
    choices = tuple[Path, ...]()
    for _ in range(_MAX_LEVELS):
        here = _Contents(at)
        references += here.references
        if here.frame_folder is not None:
            at = here.frame_folder
            notes.append(
                f"the frames are those of {_relative_name(at, folder)}; other files there are "
                "left out"
            )
            continue
        found = RecordingFiles(path=at, notes=tuple(notes), alternatives=choices)
        of_folder = (f.key for f in list_formats() if f.matches_folder(at))
        folder_format = "" if here.images else next(of_folder, "")
        if folder_format:
            return replace(found, format=folder_format)
        if here.files and not here.images:
            if _are_arrays_of_one_image(here.files):
                return replace(found, format="array_series", images=tuple(sort_series(here.files)))
            return replace(
                found,
                path=here.files[0],
                notes=(*notes, *_note_choice(here.files, folder)),
                alternatives=choices or _list_choices(here.files),
            )
        images = sort_series(here.images) or _single_images(here.folders)
        if images:
            if not here.images:
                notes.append(f"{len(images)} folders of one image each are taken as one recording")
            return replace(
                found,
                path=folder,
                images=tuple(images),
                references=(*references, *_nearby_references(at)),
                notes=tuple(notes),
            )
        inner = [f for f in here.folders if not _is_open(f) or _holds_recording(f)]
        if not inner:
            break
        # before what was derived from it, and that before what cannot be read
        inner.sort(key=lambda f: (not _is_open(f), not _TACTILE_FOLDER.search(f.name)))
        if len(inner) > 1:
            notes += _note_choice(inner, folder)
        choices = choices or _list_choices(inner)
        at = inner[0]
    raise _make_problem(folder)


class _Contents:
    """The entries of one folder by what they are."""

    def __init__(self, folder: Path) -> None:
        entries = _list_entries(folder)
        folders = {p.name: p for p in entries if p.is_dir()}
        files = [p for p in entries if p.name not in folders]
        frame_folders = (folders[n] for n in _FRAME_FOLDERS if n in folders)
        self.frame_folder = next((f for f in frame_folders if _holds_recording(f)), None)
        self.folders = [p for n, p in folders.items() if n not in _OTHER_FOLDERS]
        images = [p for p in files if is_image_file(p)]
        self.references = [p for p in images if is_reference_file(p)]
        self.images = [p for p in images if not is_reference_file(p)]
        self.files = [p for p in files if p.suffix.lower() in list_suffixes()]


def _is_open(folder: Path) -> bool:
    """Whether the user may list a folder."""
    try:
        next(folder.iterdir(), None)
    except OSError:
        return False
    return True


def _list_entries(folder: Path) -> list[Path]:
    """The entries in natural order, without hidden ones and companions of a data set."""
    entries = [
        p for p in folder.iterdir() if not p.name.startswith(".") and not _COMPANIONS.match(p.name)
    ]
    return sorted(entries, key=lambda p: natural_sort_key(p.stem))


def _list_choices(paths: list[Path]) -> tuple[Path, ...]:
    return tuple(paths) if len(paths) > 1 else ()


def _nearby_references(folder: Path) -> list[Path]:
    """Reference images in the `bgs` of this folder or its parent, else in the parent of a folder
    of presses.
    """
    found: list[Path] = []
    for place in (folder / _REFERENCE_FOLDER, folder.parent / _REFERENCE_FOLDER):
        if place.is_dir():
            found += sorted(
                filter(is_image_file, place.iterdir()), key=lambda p: natural_sort_key(p.stem)
            )
    if not found and any(p.is_dir() for p in folder.iterdir()):
        found = [p for p in folder.parent.iterdir() if is_image_file(p) and is_reference_file(p)]
    return found


def _single_images(folders: Iterable[Path]) -> list[Path]:
    """The only image of each folder, or of folders in it.

    [] unless every folder holds exactly one.
    """
    out: list[Path] = []
    for folder in folders:
        entries = _list_entries(folder) if _is_open(folder) else []
        images = [p for p in entries if is_image_file(p) and not is_reference_file(p)]
        if len(images) > 1 or folder.name in _FRAME_FOLDERS:
            return []
        images = images or _single_images(
            [p for p in entries if p.is_dir() and p.name not in _OTHER_FOLDERS]
        )
        if not images:
            return []
        out += images
    return out if len(out) > 1 else []


def _holds_recording(folder: Path) -> bool:
    """Whether a file that can be read lies in the folder or at most `_MAX_LEVELS` below."""
    level = [folder]
    suffixes = list_suffixes()
    for _ in range(_MAX_LEVELS):
        entries = [
            p for f in level if _is_open(f) for p in f.iterdir() if not p.name.startswith(".")
        ]
        if any(p.suffix.lower() in suffixes or is_image_file(p) for p in entries):
            return True
        level = [
            p for p in entries if p.is_dir() and p.name not in _OTHER_FOLDERS and not p.is_symlink()
        ]
    return False


def _are_arrays_of_one_image(files: list[Path]) -> bool:
    """Whether all files are `.npy` arrays of one shape and type with one image each, and named
    as a series.
    """
    if len(files) < _MIN_SERIES or any(file.suffix.lower() != ".npy" for file in files):
        return False
    frames = [file for file in files if not is_reference_file(file)]
    if len({re.sub(r"\d+", "#", file.stem) for file in frames}) != 1:
        return False
    try:
        kinds = {
            (array.shape, array.dtype)
            for file in frames
            for array in read_arrays(file, "the frame").values()
        }
    except FileProblem:
        return False
    shape, _ = kinds.pop()
    axis = find_colour_axis(shape)
    return not kinds and (len(shape) == 2 if axis is None else math.prod(shape[:-3]) == 1)


def _note_choice(paths: list[Path], folder: Path) -> tuple[str, ...]:
    name = _relative_name(paths[0], folder)
    if len(paths) == 1:
        return (f"the folder's one recording is {name}",)
    others = ", ".join(p.name for p in paths[1 : 1 + _MAX_NAMES]) + (
        " ..." if len(paths) > 1 + _MAX_NAMES else ""
    )
    return (
        escape_text(
            f"the folder holds {len(paths)} recordings; {name} is opened; open the others "
            f"({others}) by name"
        ),
    )


def _relative_name(path: Path, folder: Path) -> str:
    return escape_text(str(path.relative_to(folder)))


def _make_problem(folder: Path) -> FileProblem:
    if not any(folder.iterdir()):
        return FileProblem("the folder is empty", folder)
    if any(p.suffix.lower() in PICKLE_SUFFIXES for p in folder.rglob("*")):
        return FileProblem(f"the folder holds only pickles; {PICKLE_REFUSAL}", folder)
    files = sorted(p for p in folder.iterdir() if p.is_file())
    not_read = next((p for p in files if explain_not_read(p.name, b"")), None)
    if not_read is not None:
        return FileProblem(explain_not_read(not_read.name, b""), not_read)
    meshes = [p for p in _list_entries(folder) if p.suffix.lower() in _MESH_SUFFIXES]
    problem = FileProblem(
        f"the folder holds {len(meshes)} meshes and no recording; open one as the object of an "
        "open recording"
        if meshes
        else "the folder has no images and no recording of another kind",
        folder,
    )
    problem.alternatives = tuple(meshes)
    return problem
