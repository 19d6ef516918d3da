"""What lies in a folder, or deeper in a data set's own tree, that can be read as one recording.

Trees that are known by how they are laid out: frames in a folder of their own (YCB-Slide, with films and drawings
beside them), every press in a folder of its own (the calibrations of gs_sdk and gelslam), untouched pictures in `bgs`
(Sparsh), point clouds in `expand` (Punyo). Nothing is unpickled on the way.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from pipeline.base.errors import FileProblem
from pipeline.base.text import escape_text
from pipeline.recordings import image_files, video

ContentKind = Literal["images", "samples", "point_clouds", "file"]

_FRAMES = ("frames", "tactile_images", "expand")  # folders whose pictures or clouds are a sensor's, whatever is beside
_NO_FRAMES = frozenset({"webcam_frames", "gt_contactmasks", "gt_heightmaps", "obj_models", "bgs"})
_COMPANIONS = re.compile(r"^(tactile_data.*\.png|alignment\.npy|digit_data\.npy|synced_data\.npy)$")  # of YCB-Slide
_CLOUD = re.compile(r"^pc_\d+\.npy$")  # of Punyo's force estimation
_SAMPLE = re.compile(r"^(.+_)?data_\d+$")  # of touch2touch
_UNTOUCHED = "bgs"
_ARRAYS = frozenset({".h5", ".hdf5", ".npz", ".npy", ".pt", ".pth"})
_PICKLES = frozenset({".pkl", ".pickle"})
_DEEPEST = 6  # folders below the one that was named
_MOST_NAMED = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class FolderContent:
    """What to read, and what to say of it."""

    kind: ContentKind
    path: Path  # a folder, or the one file
    images: tuple[Path, ...] = ()  # in order
    references: tuple[Path, ...] = ()  # pictures of the untouched sensor that lie with them
    notes: tuple[str, ...] = field(default=())


def is_point_cloud_file(path: Path) -> bool:
    """Whether the name is that of one point cloud of a recording."""
    return _CLOUD.match(path.name) is not None


def find_recording(folder: Path) -> FolderContent:
    """The recording that a folder holds; raises FileProblem where there is none, and OSError."""
    at, notes, untouched = folder, list[str](), list[Path]()
    for _ in range(_DEEPEST):
        here = _Contents(at)
        untouched += here.untouched
        if here.frames is not None:
            at = here.frames
            notes.append(f"the frames are those of {_below(at, folder)}; what lies beside them is left out")
            continue
        if here.pictures:
            return _pictures(folder, here.pictures, untouched + _beside(at), notes)
        if here.clouds:
            return FolderContent(kind="point_clouds", path=at, notes=tuple(notes))
        if here.samples:
            return FolderContent(kind="samples", path=at, notes=tuple(notes))
        if here.files:
            return FolderContent(kind="file", path=here.files[0], notes=(*notes, *_first_of(here.files, folder)))
        presses = _one_each(here.folders)
        if presses:
            notes.append(f"{len(presses)} folders of one picture each are taken as one recording")
            return _pictures(folder, presses, untouched + _beside(at), notes)
        inside = [f for f in here.folders if _holds_something(f)]
        if not inside:
            break
        if len(inside) > 1:
            notes += _first_of(inside, folder)
        at = inside[0]
    raise _nothing(folder)


class _Contents:
    """One folder, sorted by what its entries are; hidden ones and known companions are passed over."""

    def __init__(self, folder: Path) -> None:
        every = _entries(folder)
        named = {p.name: p for p in every if p.is_dir()}
        self.frames = next((named[n] for n in _FRAMES if n in named and _holds_something(named[n])), None)
        self.folders = [p for n, p in named.items() if n not in _NO_FRAMES]
        shown = [p for p in every if p.name not in named and image_files.is_image_file(p)]
        self.untouched = [p for p in shown if image_files.is_reference_file(p)]
        self.pictures = [p for p in shown if not image_files.is_reference_file(p)]
        self.clouds = [p for p in every if is_point_cloud_file(p)]
        self.samples = any(_SAMPLE.match(p.stem) for p in folder.rglob("*.pt"))
        self.files = [p for p in every if p.name not in named and p.suffix.lower() in _ARRAYS | video.VIDEO_SUFFIXES]


def _entries(folder: Path) -> list[Path]:
    """In natural order; hidden ones and a data set's companions are passed over."""
    every = [p for p in folder.iterdir() if not p.name.startswith(".") and not _COMPANIONS.match(p.name)]
    return sorted(every, key=image_files.natural_sort_key)


def _pictures(folder: Path, files: list[Path], untouched: list[Path], notes: list[str]) -> FolderContent:
    return FolderContent(
        kind="images", path=folder, images=tuple(files), references=tuple(untouched), notes=tuple(notes)
    )


def _beside(folder: Path) -> list[Path]:
    """Untouched pictures in the `bgs` of this folder or the one above, and of presses' parent folder."""
    found: list[Path] = []
    for place in (folder / _UNTOUCHED, folder.parent / _UNTOUCHED):
        if place.is_dir():
            found += sorted(filter(image_files.is_image_file, place.iterdir()), key=image_files.natural_sort_key)
    if not found and any(p.is_dir() for p in folder.iterdir()):
        found = [
            p for p in folder.parent.iterdir() if image_files.is_image_file(p) and image_files.is_reference_file(p)
        ]
    return found


def _one_each(folders: Iterable[Path]) -> list[Path]:
    """The only pictures of folders, or of folders in them, that hold exactly one each; none where one does not."""
    out: list[Path] = []
    for folder in folders:
        every = _entries(folder)
        shown = [p for p in every if image_files.is_image_file(p) and not image_files.is_reference_file(p)]
        if len(shown) > 1 or folder.name in _FRAMES:
            return []
        more = shown or _one_each([p for p in every if p.is_dir() and p.name not in _NO_FRAMES])
        if not more:
            return []
        out += more
    return out if len(out) > 1 else []


def _holds_something(folder: Path) -> bool:
    """Whether anything that can be read lies in a folder or below, a few folders deep."""
    level = [folder]
    for _ in range(_DEEPEST):
        entries = [p for f in level for p in f.iterdir() if not p.name.startswith(".")]
        if any(p.suffix.lower() in _ARRAYS | video.VIDEO_SUFFIXES or image_files.is_image_file(p) for p in entries):
            return True
        level = [p for p in entries if p.is_dir() and p.name not in _NO_FRAMES and not p.is_symlink()]
    return False


def _first_of(several: list[Path], folder: Path) -> tuple[str, ...]:
    if len(several) == 1:
        return (f"the folder's one recording is {_below(several[0], folder)}",)
    others = ", ".join(p.name for p in several[1 : 1 + _MOST_NAMED]) + (
        " ..." if len(several) > 1 + _MOST_NAMED else ""
    )
    return (escape_text(f"the folder holds {len(several)} recordings; {_below(several[0], folder)} is opened, "
                  f"the others ({others}) by their own names"),)  # fmt: skip


def _below(path: Path, folder: Path) -> str:
    return escape_text(str(path.relative_to(folder)))


def _nothing(folder: Path) -> FileProblem:
    if not any(folder.iterdir()):
        return FileProblem("the folder is empty", folder)
    if any(p.suffix.lower() in _PICKLES for p in folder.rglob("*")):
        return FileProblem(f"all that the folder holds are pickles; {PICKLE_REFUSAL}", folder)
    return FileProblem("the folder has no images to show, and no recording of another kind", folder)


PICKLE_REFUSAL = (
    "a pickle can run code when it is loaded and is refused: in the program that made it, save the pictures as PNG "
    "files, or the arrays with numpy.savez"
)
