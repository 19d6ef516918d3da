"""The touch2touch data set: one `.pt` file per grasp and sensor with both fingers, lengths in metres.

Keys and shapes of the published data set: `bubble_imprint`, `bubble_depth_ref` (2, 1, 140, 175) and `K` of
the full 224 x 171 image, or `gelslim`, `gelslim_ref` (2, 3, 320, 427). Index 0 is the right finger, 1 the left one.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base.arrays import Doubles, freeze
from pipeline.base.errors import CalibrationError, FileProblem
from pipeline.geometry import rigid
from pipeline.geometry.camera import make_camera
from pipeline.geometry.meshes import Mesh, load_mesh
from pipeline.recordings import torch_files
from pipeline.recordings.formats import RecordingFiles
from pipeline.recordings.index_check import with_index_check
from pipeline.values.frames import Recording, Stream, TactileFrame, Truth

_FINGERS = ("right", "left")
_FULL_ROWS, _FULL_COLS, _TOP, _LEFT = 171, 224, 20, 25  # released pairs are a window of the camera's image
_BUBBLE, _GELSLIM = (140, 175), (320, 427)  # (rows, cols)
_NAME = re.compile(r"^(?:(?P<tool>.+)_)?data_(?P<id>\d+)$")
_FOLDER = re.compile(r"^(?:bubble|gelslim)_style_transfer_dataset_(?:bubbles|gelslim)_(?P<tool>.+)$")
_MM_PER_M = 1000.0
_POSE_KEYS = ("bubbles_tr_quat", "tool_tr_quat")  # of the sensors and of the tool, in the robot's base frame


def is_grasp_file(files: RecordingFiles) -> bool:
    """Whether the file is a dictionary of tensors with a grasp."""
    return torch_files.is_torch_file(files) and not {"bubble_imprint", "gelslim"}.isdisjoint(
        torch_files.load_tensors(files.path)
    )


def is_grasp_folder(folder: Path) -> bool:
    """Whether files below the folder are named as grasps."""
    return any(_NAME.match(p.stem) for p in folder.rglob("*.pt"))


def read(path: Path) -> Recording:
    """A folder of grasps, or one grasp as two streams, one per finger; raises FileProblem."""
    if path.is_dir():
        return _read_folder(path)
    bubble = "bubble_imprint" in torch_files.load_tensors(path)
    streams = _streams([path], path, bubble=bubble)
    return Recording(
        path=path, format="touch2touch sample", streams=streams, object_mesh=_load_tool_mesh([path]), notes=_NOTES
    )


def _read_folder(path: Path) -> Recording:
    """All grasps of a folder; where it has both sensors, frame `i` of each stream is the same grasp.

    Reads `bubbles` and `gelslims` folders with one folder per tool (`data/..._<tool>/data_<i>.pt`) or with all grasps
    together (`<tool>_data_<i>.pt`), and folders of one sensor.
    """
    sides: dict[bool, dict[tuple[str, int], Path]] = {True: {}, False: {}}
    for file in sorted(path.rglob("*.pt")):
        key = _parse_grasp(file)
        if key is not None:
            sides[_is_bubble(file, path)][key] = file
    bubbles, gelslims = sides[True], sides[False]
    if not bubbles and not gelslims:
        raise FileProblem("the folder has no touch2touch samples (names end in data_<number>.pt)", path)
    both = sorted(bubbles.keys() & gelslims.keys()) if bubbles and gelslims else sorted(bubbles or gelslims)
    if not both:
        raise FileProblem("no grasp of this folder was recorded by both sensors: names do not match", path)
    n_unpaired = len(bubbles.keys() ^ gelslims.keys()) if bubbles and gelslims else 0
    notes = (*_NOTES, *((f"{n_unpaired} grasps of only one sensor are left out",) if n_unpaired else ()))
    streams = tuple(
        stream
        for side, bubble in ((gelslims, False), (bubbles, True))
        if side
        for stream in _streams([side[key] for key in both], path, bubble=bubble)
    )
    files = [side[key] for side in (bubbles, gelslims) if side for key in both]
    return Recording(
        path=path, format="touch2touch folder", streams=streams, object_mesh=_load_tool_mesh(files), notes=notes
    )


_NOTES = (
    "lengths in the files are in metres; they are converted to millimetres",
    "bubble poses are those that the robot recorded; gelslim poses are left out, since their axes are not published",
)


def _streams(files: list[Path], path: Path, *, bubble: bool) -> tuple[Stream, ...]:
    @lru_cache(maxsize=2)
    def load(index: int) -> Mapping[str, Any]:
        return torch_files.load_tensors(files[index])

    build = _bubble_frame if bubble else _gelslim_frame
    sensor = "soft_bubble" if bubble else "gelslim"

    def build_stream(finger: int) -> Stream:
        def frame(index: int) -> TactileFrame:
            return build(load(index), finger, index, files[index])

        def truth(index: int) -> Truth | None:
            return _read_pose(load(index), finger, files[index]) if bubble else None

        n = len(files)
        return Stream(name=f"{sensor} {_FINGERS[finger]}", sensor=sensor, n_frames=n, has_truth=bubble,
                      frame=with_index_check(frame, n, path), truth=with_index_check(truth, n, path))  # fmt: skip

    return build_stream(0), build_stream(1)


def _bubble_frame(tensors: Mapping[str, Any], finger: int, index: int, file: Path) -> TactileFrame:
    imprint = torch_files.require_tensor(tensors, "bubble_imprint", file, (2, 1, *_BUBBLE))[finger, 0].double().numpy()
    reference = (
        torch_files.require_tensor(tensors, "bubble_depth_ref", file, (2, 1, *_BUBBLE))[finger, 0].double().numpy()
    )
    median_m = float(np.median(reference[np.isfinite(reference)])) if np.isfinite(reference).any() else np.nan
    if not 0.02 < median_m < 0.5 or (np.abs(reference) > 0.5).any() or (np.abs(imprint) > 0.5).any():
        raise FileProblem(
            f"bubble_depth_ref and bubble_imprint must be in metres, but the median is {median_m:g}",
            file,
            field="bubble_depth_ref",
        )
    k = torch_files.require_tensor_rows(tensors, "K", file, (3, 3)).double().numpy()
    try:
        full = make_camera(k[min(finger, len(k) - 1)], _FULL_ROWS, _FULL_COLS, what="K")
    except CalibrationError as error:
        raise CalibrationError(f"{error}: '{file}'") from error
    return TactileFrame(
        sensor="soft_bubble", image=freeze(((reference - imprint) * _MM_PER_M).astype(np.float32)),
        reference=freeze((reference * _MM_PER_M).astype(np.float32)), index=index,
        origin=f"{file} [{_FINGERS[finger]}]", camera=full.crop(_TOP, _LEFT, *_BUBBLE),
    )  # fmt: skip


def _gelslim_frame(tensors: Mapping[str, Any], finger: int, index: int, file: Path) -> TactileFrame:
    images = torch_files.require_tensor(tensors, "gelslim", file, (2, 3, *_GELSLIM))
    references = torch_files.require_tensor(tensors, "gelslim_ref", file, (2, 3, *_GELSLIM))
    return TactileFrame(
        sensor="gelslim", image=torch_files.convert_to_rgb(images[finger], "gelslim", file),
        reference=torch_files.convert_to_rgb(references[finger], "gelslim_ref", file), index=index,
        origin=f"{file} [{_FINGERS[finger]}]",
    )  # fmt: skip


def _read_pose(tensors: Mapping[str, Any], finger: int, file: Path) -> Truth | None:
    """Pose of the tool in the bubble camera's frame; both are recorded in the robot's base frame."""
    if any(key not in tensors for key in _POSE_KEYS):
        return None
    try:
        sensors, tools = (
            _parse_transforms(torch_files.require_tensor_rows(tensors, key, file, (7,))) for key in _POSE_KEYS
        )
        base_from_sensor, base_from_tool = sensors[min(finger, len(sensors) - 1)], tools[0]
        pose = rigid.validate_within_reach(
            rigid.invert(base_from_sensor) @ base_from_tool, "the tool in the bubble's frame"
        )
    except CalibrationError as error:
        raise CalibrationError(f"{error}: '{file}'") from error
    return Truth(sensor_from_object=freeze(pose))


def _parse_transforms(rows: Any) -> list[Doubles]:
    values = rows.double().numpy()
    if not np.isfinite(values).all():
        raise CalibrationError("a pose of the tool or of a sensor has values that are not finite")
    return [rigid.from_quaternion(row[:3] * _MM_PER_M, row[3:]) for row in values]


def _parse_grasp(file: Path) -> tuple[str, int] | None:
    """(tool, number) of a sample, from its own name or its folder's."""
    match = _NAME.match(file.stem)
    if match is None:
        return None
    folder = _FOLDER.match(file.parent.name)
    tool = match["tool"] or (folder["tool"] if folder else "")
    return tool, int(match["id"])


def _is_bubble(file: Path, root: Path) -> bool:
    for part in reversed(file.relative_to(root.parent).parts[:-1]):
        if part.startswith("bubble"):
            return True
        if part.startswith("gelslim"):
            return False
    return "bubble_imprint" in torch_files.load_tensors(file)


def _load_tool_mesh(files: list[Path]) -> Mesh | None:
    """The mesh of the only tool, if the folder `tools_stls` lies above the grasps; else None."""
    tools = {key[0] for key in map(_parse_grasp, files) if key is not None}
    if len(tools) != 1:
        return None
    name = f"{next(iter(tools))}.stl"
    candidates = (folder / "tools_stls" / name for folder in Path(os.path.realpath(files[0])).parents)
    file = next((p for p in candidates if p.is_file()), None)
    return None if file is None else load_mesh(file, unit="m")
