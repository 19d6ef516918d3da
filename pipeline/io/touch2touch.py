"""The touch2touch data set: one `.pt` file per grasp and sensor with both fingers, lengths in
metres.

Keys and shapes of the published data set: `bubble_imprint`, `bubble_depth_ref` (2, 1, 140, 175) and
`K` of the full 224 x 171 image, or `gelslim`, `gelslim_ref` (2, 3, 320, 427). Index 0 is the right
finger, 1 the left one. Files of a single finger have a first length of 1.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.core.arrays import Doubles, freeze
from pipeline.core.errors import CalibrationError, FileProblem, naming_file
from pipeline.core.geometry import rigid
from pipeline.core.geometry.camera import make_camera
from pipeline.core.geometry.meshes import Mesh, load_mesh
from pipeline.core.values.frames import Grasp, Recording, Stream, TactileFrame, Truth
from pipeline.io import torch_files
from pipeline.io.formats import RecordingFiles, with_index_check
from pipeline.io.grasp_files import (
    BUBBLE,
    GEL,
    GraspFiles,
    describe_splits,
    find_tool_mesh,
    list_grasps,
    parse_tool,
)

_FINGERS = ("right", "left")
# released pairs are a window of the camera's image
_FULL_ROWS = 171
_FULL_COLS = 224
_TOP = 20
_LEFT = 25
# rows and columns
_BUBBLE = (140, 175)
_GELSLIM = (320, 427)
# rad, m: the tool's pose, the same for both sensors
_IN_HAND_TOLERANCE = {"theta": 0.02, "x": 1e-3, "y": 1e-3}
_MM_PER_M = 1000.0
_IMAGES = {BUBBLE: "bubble_imprint", GEL: "gelslim"}  # sensor -> key that counts the fingers
_GRASP_KEY = "grasp_frame_quat"  # of the frame between the fingers, in the robot's base frame
# of the sensors and of the tool, in the robot's base frame
_POSE_KEYS = ("bubbles_tr_quat", "tool_tr_quat")


def is_grasp_file(files: RecordingFiles) -> bool:
    """Whether the file is a dictionary of tensors with a grasp."""
    return torch_files.is_torch_file(files) and not {"bubble_imprint", "gelslim"}.isdisjoint(
        torch_files.load_tensors(files.path)
    )


def read(path: Path) -> Recording:
    """A folder of grasps, or one grasp as two streams, one per finger; raises FileProblem."""
    if path.is_dir():
        return _read_folder(path)
    sensor = BUBBLE if "bubble_imprint" in torch_files.load_tensors(path) else GEL
    grasp = GraspFiles(Grasp(tool=parse_tool(path)), {sensor: path})
    return Recording(
        path=path,
        format="touch2touch sample",
        streams=_streams([grasp], path, sensor),
        object_mesh=_load_tool_mesh([grasp]),
        notes=_NOTES,
    )


def _read_folder(path: Path) -> Recording:
    """All grasps of a folder; where it has both sensors, frame `i` of each stream is the same
    grasp.
    """
    folder = list_grasps(path)
    grasps = folder.grasps
    streams = [_streams(grasps, path, sensor) for sensor in folder.sensors]
    n_fingers = max(len(of_sensor) for of_sensor in streams)
    return Recording(
        path=path,
        format="touch2touch folder",
        object_mesh=_load_tool_mesh(grasps),
        streams=tuple(stream for of_sensor in streams for stream in of_sensor),
        notes=(describe_splits(grasps, n_fingers), *folder.notes, *_NOTES),
        grasps=tuple(g.grasp for g in grasps),
        find_pair_problem=lambda index: _find_pair_problem(grasps[index]),
    )


def _find_pair_problem(grasp: GraspFiles) -> str:
    """Why the files of a grasp are not of one touch.

    "" where they are, or where only one sensor was there.
    """
    try:
        loaded = [torch_files.load_tensors(file) for file in grasp.files.values()]
        for key, tolerance in _IN_HAND_TOLERANCE.items():
            values = [float(tensors[key]) for tensors in loaded if key in tensors]
            if len(values) == len(loaded) > 1 and abs(values[0] - values[1]) > tolerance:
                return f"{key} is {values[0]:.4g} for one sensor and {values[1]:.4g} for the other"
    except (FileProblem, TypeError, ValueError, RuntimeError) as error:
        return str(error)
    return ""


_NOTES = (
    "lengths in the files are in metres; they are converted to millimetres",
    "bubble poses are those that the robot recorded; gelslim poses are left out, since their axes "
    "are not published",
)


def _streams(grasps: Sequence[GraspFiles], path: Path, sensor: str) -> tuple[Stream, ...]:
    @lru_cache(maxsize=2)
    def load(index: int) -> Mapping[str, Any]:
        return torch_files.load_tensors(grasps[index].files[sensor])

    is_bubble = sensor == BUBBLE
    build = _bubble_frame if is_bubble else _gelslim_frame

    def build_stream(finger: int) -> Stream:
        def frame(index: int) -> TactileFrame:
            return build(load(index), finger, index, grasps[index].files[sensor])

        def truth(index: int) -> Truth | None:
            if not is_bubble:
                return None
            pose = _read_pose(load(index), finger, grasps[index].files[sensor])
            depth = grasps[index].bubble_depth
            return (
                pose if depth is None else _add_depth(pose or Truth(), frame(index), depth, finger)
            )

        n = len(grasps)
        return Stream(
            name=f"{sensor} {_FINGERS[finger]}",
            sensor=sensor,
            n_frames=n,
            has_truth=is_bubble,
            frame=with_index_check(frame, n, path),
            truth=with_index_check(truth, n, path),
        )

    return tuple(
        build_stream(finger) for finger in range(_count_fingers(grasps[0].files[sensor], sensor))
    )


def _count_fingers(file: Path, sensor: str) -> int:
    """Fingers in a file, of which all of a folder have the same number.

    Two where the file cannot be read.
    """
    try:
        return _count_rows(torch_files.load_tensors(file), _IMAGES[sensor])
    except FileProblem:
        return len(_FINGERS)


def _count_rows(tensors: Mapping[str, Any], key: str) -> int:
    """1 where the tensor is of a single finger, else 2."""
    return 1 if tuple(getattr(tensors.get(key), "shape", ()))[:1] == (1,) else len(_FINGERS)


def _select_finger(
    tensors: Mapping[str, Any], key: str, file: Path, tail: tuple[int, ...], finger: int
) -> Any:
    """The part (*tail) of a tensor (1 or 2, *tail) that is of a finger; raises FileProblem."""
    n = _count_rows(tensors, key)
    both = torch_files.require_tensor(tensors, key, file, (n, *tail))
    if finger >= n:
        raise FileProblem(f"{key} holds one finger, other files of the folder two", file)
    return both[finger]


def _add_depth(truth: Truth, frame: TactileFrame, file: Path, finger: int) -> Truth:
    """Truth with the touched surface of a depth file: metres from the camera, 0 or less where
    nothing is touched.
    """
    values = (
        torch_files.require_tensor_rows(torch_files.load_tensors(file), "depth", file, _BUBBLE)
        .double()
        .numpy()
    )
    depth_mm = values[min(finger, len(values) - 1)] * _MM_PER_M
    contact = np.isfinite(depth_mm) & (depth_mm > 0.0)
    assert frame.reference is not None
    if contact.any() and not 20.0 < float(np.median(depth_mm[contact])) < 500.0:
        raise FileProblem(
            f"depth must be in metres, its median is {np.median(depth_mm[contact]) / _MM_PER_M:g}",
            file,
        )
    indentation = np.where(contact, np.maximum(frame.reference - depth_mm, 0.0), 0.0).astype(
        np.float32
    )
    return replace(
        truth, indentation_mm=freeze(indentation), contact=freeze(contact & (indentation > 0.0))
    )


def _bubble_frame(tensors: Mapping[str, Any], finger: int, index: int, file: Path) -> TactileFrame:
    imprint, reference = (
        _select_finger(tensors, key, file, (1, *_BUBBLE), finger)[0].double().numpy()
        for key in ("bubble_imprint", "bubble_depth_ref")
    )
    median_m = (
        float(np.median(reference[np.isfinite(reference)]))
        if np.isfinite(reference).any()
        else np.nan
    )
    if (
        not 0.02 < median_m < 0.5
        or (np.abs(reference) > 0.5).any()
        or (np.abs(imprint) > 0.5).any()
    ):
        raise FileProblem(
            "bubble_depth_ref and bubble_imprint must be in metres, but the median is "
            f"{median_m:g}",
            file,
        )
    k = torch_files.require_tensor_rows(tensors, "K", file, (3, 3)).double().numpy()
    with naming_file(file):
        full = make_camera(k[min(finger, len(k) - 1)], _FULL_ROWS, _FULL_COLS, what="K")
    return TactileFrame(
        sensor="soft_bubble",
        image=freeze(((reference - imprint) * _MM_PER_M).astype(np.float32)),
        reference=freeze((reference * _MM_PER_M).astype(np.float32)),
        index=index,
        origin=f"{file} [{_FINGERS[finger]}]",
        camera=full.crop(_TOP, _LEFT, *_BUBBLE),
        grasp_range=_compute_range(
            _MM_PER_M * (tensors["bubble_depth_ref"] - tensors["bubble_imprint"])
        ),
    )


def _compute_range(values: Any) -> tuple[float, float] | None:
    """Least and largest value of both fingers; None where nothing is measured."""
    finite = values[values.isfinite()]
    return (float(finite.min()), float(finite.max())) if len(finite) else None


def _gelslim_frame(tensors: Mapping[str, Any], finger: int, index: int, file: Path) -> TactileFrame:
    image, reference = (
        _select_finger(tensors, key, file, (3, *_GELSLIM), finger)
        for key in ("gelslim", "gelslim_ref")
    )
    return TactileFrame(
        sensor="gelslim",
        image=torch_files.convert_to_rgb(image, "gelslim", file),
        reference=torch_files.convert_to_rgb(reference, "gelslim_ref", file),
        index=index,
        origin=f"{file} [{_FINGERS[finger]}]",
        grasp_range=_compute_range(tensors["gelslim"]),
    )


def _read_pose(tensors: Mapping[str, Any], finger: int, file: Path) -> Truth | None:
    """Pose of the tool in the bubble camera's frame.

    Both are recorded in the robot's base frame.
    """
    if any(key not in tensors for key in _POSE_KEYS):
        return None
    with naming_file(file):
        sensors, tools = (
            _parse_transforms(torch_files.require_tensor_rows(tensors, key, file, (7,)))
            for key in _POSE_KEYS
        )
        base_from_sensor = sensors[min(finger, len(sensors) - 1)]
        base_from_tool = tools[0]
        grasp_from_sensor = None
        if _GRASP_KEY in tensors:
            rows = torch_files.require_tensor_rows(tensors, _GRASP_KEY, file, (7,))
            grasp_from_sensor = freeze(rigid.invert(_parse_transforms(rows)[0]) @ base_from_sensor)
        pose = rigid.validate_within_reach(
            rigid.invert(base_from_sensor) @ base_from_tool, "the tool in the bubble's frame"
        )
    return Truth(sensor_from_object=freeze(pose), grasp_from_sensor=grasp_from_sensor)


def _parse_transforms(rows: Any) -> list[Doubles]:
    values = rows.double().numpy()
    if not np.isfinite(values).all():
        raise CalibrationError("a pose of the tool or of a sensor has values that are not finite")
    return [rigid.from_quaternion(row[:3] * _MM_PER_M, row[3:]) for row in values]


def _load_tool_mesh(grasps: Sequence[GraspFiles]) -> Mesh | None:
    """The mesh of the only tool; None where there are several or it has none."""
    file = find_tool_mesh(grasps[0]) if len({g.grasp.tool for g in grasps}) == 1 else None
    return None if file is None else load_mesh(file, unit="m")
