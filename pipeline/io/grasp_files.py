"""Files of a touch2touch data set: which belong to one grasp, and to which split.

Layouts of the published sets: `<split>/{bubbles,gelslims}/data/..._<tool>/data_<i>.pt`,
`<split>/{bubbles,gelslims}/ <tool>_data_<i>.pt`, undistorted images in `gelslims_no_distortion` or
`gelslims_undistorted`, depth in `<folder>_depth`, and `split.json`, which lists (tool, number) by
split. A split is the folder of both sensors' folders.
"""

import os
import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from pipeline.core.errors import FileProblem, escape_text
from pipeline.core.files import read_json
from pipeline.core.typed_data import Name, convert
from pipeline.core.values.frames import Grasp
from pipeline.io import torch_files

BUBBLE = "soft_bubble"
GEL = "gelslim"
SENSORS = (GEL, BUBBLE)
_KEYS = {"bubble_imprint": BUBBLE, "gelslim": GEL}  # a tensor of the file -> its sensor
_NAME = re.compile(r"^(?:(?P<tool>.+)_)?data_(?P<number>\d+)$")
_TOOL_FOLDER = re.compile(
    r"^(?:bubble|gelslim)_style_transfer_dataset_(?:bubbles|gelslim)_(?P<tool>.+)$"
)
_SENSOR_FOLDER = re.compile(r"^(?P<sensor>bubble|gelslim)s?(?:_.*)?$")
_DEPTH = "_depth"
_SPLIT_FILE = "split.json"
_TRAIN = "train"
_MAX_NAMES = 5  # in a note


@dataclass(frozen=True, slots=True)
class GraspFiles:
    """The files of one grasp."""

    grasp: Grasp
    files: Mapping[str, Path]  # by sensor
    bubble_depth: Path | None = None  # of the surface that a bubble touches


@dataclass(frozen=True, slots=True)
class GraspFolder:
    """The grasps of a folder in order: trained on first, then by split, tool and number."""

    grasps: tuple[GraspFiles, ...]
    sensors: tuple[str, ...]
    notes: tuple[str, ...]


# sensor -> name of the folder -> file of one grasp; "" = not in a folder of one sensor
_Found = dict[str, dict[str, Path]]


def is_grasp_folder(folder: Path) -> bool:
    """Whether files below the folder are named as grasps."""
    return any(_NAME.match(p.stem) for p in folder.rglob("*.pt"))


def parse_tool(file: Path) -> str:
    """Tool of a grasp's file, from its own name or its folder's; "" = not named."""
    match = _NAME.match(file.stem)
    folder = _TOOL_FOLDER.match(file.parent.name)
    return (match["tool"] if match else None) or (folder["tool"] if folder else "")


def list_grasps(root: Path) -> GraspFolder:
    """The grasps below a folder.

    Of both sensors where it holds both. Raises FileProblem where there are none.
    """
    found = defaultdict[Grasp, _Found](lambda: {sensor: {} for sensor in SENSORS})
    others: list[Path] = []
    for file in sorted(root.rglob("*.pt")):
        match = _NAME.match(file.stem)
        if match is None:
            continue
        sensor, folder, split = _locate(file, root)
        if not sensor:
            others.append(file)
            continue
        grasp = Grasp(tool=parse_tool(file), split=split, number=int(match["number"]))
        found[grasp][sensor].setdefault(folder, file)
    chosen, notes = _choose_folders(found)
    depth_folder = f"{chosen.get(BUBBLE, '')}{_DEPTH}"
    grasps = [
        GraspFiles(
            grasp=grasp,
            files={s: f[s][folder] for s, folder in chosen.items() if folder in f[s]},
            bubble_depth=f[BUBBLE].get(depth_folder),
        )
        for grasp, f in found.items()
    ]
    grasps = [g for g in grasps if g.files]
    sensors = tuple(s for s in SENSORS if any(s in g.files for g in grasps))
    if not grasps:
        raise FileProblem(
            "the folder has no touch2touch samples (names end in data_<number>.pt)", root
        )
    paired = [g for g in grasps if len(g.files) == len(sensors)]
    if not paired:
        raise FileProblem(
            "no grasp of this folder was recorded by both sensors: names do not match", root
        )
    unpaired = [
        f"{g.grasp.name} (only {next(iter(g.files))})"
        for g in grasps
        if len(g.files) < len(sensors)
    ]
    listed, split_notes = _apply_split_file(paired, root)
    notes += [
        *split_notes,
        *_count("grasps of only one sensor are left out", unpaired),
        *_count(
            "files are left out, which hold neither a bubble's imprint nor a GelSlim's image",
            [str(p.relative_to(root)) for p in others],
        ),
    ]
    meshes = {g.grasp.tool: find_tool_mesh(g) for g in listed}
    listed = [replace(g, grasp=replace(g.grasp, mesh_file=meshes[g.grasp.tool])) for g in listed]
    ordered = sorted(
        listed,
        key=lambda g: (
            not is_training_split(g.grasp.split),
            g.grasp.split,
            g.grasp.tool,
            g.grasp.number,
        ),
    )
    return GraspFolder(tuple(ordered), sensors, tuple(notes))


def find_tool_mesh(grasp: GraspFiles) -> Path | None:
    """The mesh of a grasp's tool in a folder `tools_stls` above its files.

    None where there is none.
    """
    first = next(iter(grasp.files.values()))
    candidates = (
        folder / "tools_stls" / f"{grasp.grasp.tool}.stl"
        for folder in Path(os.path.realpath(first)).parents
    )
    return next((p for p in candidates if p.is_file()), None)


def is_training_split(split: str) -> bool:
    """Whether a split of this name is trained on; a set without splits is."""
    return not split or split.startswith(_TRAIN)


def _locate(file: Path, root: Path) -> tuple[str, str, str]:
    """(sensor, its folder, split) of a file; sensor "" = neither."""
    parts = file.relative_to(root).parts[:-1]
    for k, part in enumerate((*parts, root.name)):
        match = _SENSOR_FOLDER.match(part)
        if match:
            folder = "" if k < len(parts) and _TOOL_FOLDER.match(part) else part
            split = "/".join(parts[:k]) if k < len(parts) else ""
            return (BUBBLE if match["sensor"] == "bubble" else GEL), folder, split
    tensors = torch_files.load_tensors(file)
    return next((s for key, s in _KEYS.items() if key in tensors), ""), "", "/".join(parts)


def _choose_folders(found: Mapping[Grasp, _Found]) -> tuple[dict[str, str], list[str]]:
    """Sensor -> the folder that is read where a set has several, such as undistorted images.

    And notes.
    """
    chosen: dict[str, str] = {}
    notes: list[str] = []
    for sensor in SENSORS:
        names = dict.fromkeys(
            name for f in found.values() for name in f[sensor] if not name.endswith(_DEPTH)
        )
        if names:
            chosen[sensor] = min(names, key=lambda name: (len(name), name))
        if len(names) > 1:
            notes.append(
                f"{chosen[sensor]} is read; {', '.join(n for n in names if n != chosen[sensor])} "
                "is left out"
            )
    if any(name.endswith(_DEPTH) for f in found.values() for name in f[GEL]):
        notes.append(
            "depth of the GelSlim is left out: it is a distance from a camera whose distance to "
            "the gel is unknown"
        )
    return chosen, notes


def _apply_split_file(grasps: list[GraspFiles], root: Path) -> tuple[list[GraspFiles], list[str]]:
    """The grasps with the splits of `split.json`, if there is one.

    It counts for the folders that are trained on.
    """
    file = next(iter(sorted(root.rglob(_SPLIT_FILE))), None)
    if file is None:
        return grasps, []
    split_of = read_split_file(file)
    one_folder = len({g.grasp.split for g in grasps}) == 1
    out: list[GraspFiles] = []
    missing = dict.fromkeys(split_of)
    for g in grasps:
        key = g.grasp.tool, g.grasp.number
        if key in split_of and (one_folder or is_training_split(g.grasp.split)):
            missing.pop(key, None)
            out.append(replace(g, grasp=replace(g.grasp, split=split_of[key])))
        else:
            out.append(g)
    return out, [
        f"splits are those of {file.name}",
        *_count(f"grasps of {file.name} are not in the folder", [f"{t} {n}" for t, n in missing]),
    ]


def read_split_file(file: Path) -> dict[tuple[str, int], str]:
    """(tool, number) -> split, from a JSON object of lists of [tool, number].

    Raises FileProblem.
    """
    data = convert(
        read_json(file, "the split file"),
        dict[str, list[tuple[Name, int | str]]],
        "the split file",
        file,
        remedy="it is a table of lists of [tool, number], by split",
    )
    try:
        entries = [
            (tool, int(str(number).removeprefix("data_")), split)
            for split, pairs in data.items()
            for tool, number in pairs
        ]
    except ValueError as error:
        raise FileProblem(
            f"the split file cannot be used ({error}); numbers look like 12 or data_12", file
        ) from error
    out: dict[tuple[str, int], str] = {}
    for tool, number, split in entries:
        if out.setdefault((tool, number), split) != split:
            raise FileProblem(
                f"{tool} {number} is in two splits, {out[tool, number]} and {split}", file
            )
    return out


def describe_splits(grasps: Iterable[GraspFiles], n_fingers: int) -> str:
    """Numbers of grasps, tools and fingers, and the grasps of each split."""
    counts = Counter(g.grasp.split for g in grasps)
    n_tools = len({g.grasp.tool for g in grasps})
    splits = " + ".join(f"{n} {escape_text(split)}".strip() for split, n in counts.items())
    tools = f"of {n_tools} tool{'s' if n_tools > 1 else ''}"
    return (
        f"{sum(counts.values())} grasps {tools}, "
        f"{'two fingers' if n_fingers > 1 else 'one finger'} each"
        + (f": {splits}" if len(counts) > 1 or "" not in counts else "")
    )


def _count(what: str, names: list[str]) -> Iterator[str]:
    """A note with the first names, if there are any."""
    if names:
        more = ", ..." if len(names) > _MAX_NAMES else ""
        yield f"{len(names)} {what}: {escape_text(', '.join(names[:_MAX_NAMES]))}{more}"
