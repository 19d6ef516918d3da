"""Files of other viewers: .rrd of Rerun and .mcap of Foxglove, with all stages of all frames on one
time line.

Lengths are in metres and positions in the target's frame, as both viewers expect; times are the
recording's, from 0 on in .mcap where they are negative.
"""

import tempfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.core.arrays import Doubles, Floats, Image
from pipeline.core.errors import FileProblem, SettingProblem
from pipeline.core.files import open_atomic
from pipeline.core.geometry import rigid
from pipeline.core.geometry.meshes import Mesh
from pipeline.io.mcap_images import PREVIEW_PROFILE

_M_PER_MM = 1e-3
_POINT_FIELDS = ("x", "y", "z", "red", "green", "blue", "alpha")
_OBJECT = "object"
_MAX_TIME_S = 2.5e11  # of a .mcap: the year 9892


@dataclass(frozen=True, slots=True, kw_only=True)
class StageSample:
    """What one stage shows of one frame."""

    name: str  # of the stage or the source pane
    frame: int
    time_s: float
    pixels: Image  # (rows, cols, 3)
    points_mm: Floats  # (n, 3) in the target's frame
    rgb: Image  # (n, 3)
    # (rows, cols) z of the membrane, NaN = no value; None = the stage has no depth
    depth_mm: Floats | None = None
    target_from_object: Doubles | None = None  # (4, 4) mm, of the pose stage
    metrics: Mapping[str, float]  # against truth


def write_rrd(path: Path, samples: Iterable[StageSample], mesh: Mesh | None) -> None:
    """Write a Rerun recording: images, depth, points, metrics, and the object's pose and mesh."""
    try:
        import rerun as rr
    except ImportError as error:
        raise _make_problem("rerun-sdk", ".rrd") from error
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder) / "stages.rrd"
        log = rr.RecordingStream("tactoscope", recording_id=path.stem, send_properties=False)
        log.set_log_time_enabled(False)  # the same content gives the same times
        log.set_log_tick_enabled(False)
        log.save(made)
        if mesh is not None:
            vertices_m = mesh.vertices_mm * _M_PER_MM
            log.log(
                _OBJECT,
                rr.Mesh3D(vertex_positions=vertices_m, triangle_indices=mesh.triangles),
                static=True,
            )
        for sample in samples:
            log.set_time("frame", sequence=sample.frame)
            log.set_time("time", duration=sample.time_s)
            log.log(f"{sample.name}/image", rr.Image(sample.pixels))
            log.log(
                f"{sample.name}/points",
                rr.Points3D(sample.points_mm * _M_PER_MM, colors=sample.rgb),
            )
            if sample.depth_mm is not None:
                log.log(
                    f"{sample.name}/depth",
                    rr.DepthImage(sample.depth_mm * np.float32(_M_PER_MM), meter=1.0),
                )
            if sample.target_from_object is not None:
                pose = sample.target_from_object
                log.log(
                    _OBJECT,
                    rr.Transform3D(translation=pose[:3, 3] * _M_PER_MM, mat3x3=pose[:3, :3]),
                )
            for name, value in sample.metrics.items():
                log.log(f"metrics/{name.replace('.', '/')}", rr.Scalars(value))
        try:
            log.flush()
        except RuntimeError as error:
            raise FileProblem(
                f"cannot write the Rerun recording (no room for it in {folder!r}?)", path
            ) from error
        log.disconnect()
        with open_atomic(path, "the Rerun recording", None) as file:
            file.write(made.read_bytes())


def write_mcap(path: Path, samples: Iterable[StageSample]) -> None:
    """Write messages with Foxglove's schemas: PNG images, 32-bit depth images, point clouds, and
    the object's pose.
    """
    try:
        from mcap_protobuf.writer import Writer
    except ImportError as error:
        raise _make_problem("mcap-protobuf-support foxglove-schemas-protobuf", ".mcap") from error
    with open_atomic(path, "the MCAP file", None) as file:
        writer: Any = Writer(file, profile=PREVIEW_PROFILE)
        start_s: float | None = None
        for sample in samples:
            # the format has no negative times
            start_s = min(sample.time_s, 0.0) if start_s is None else start_s
            if not sample.time_s - start_s < _MAX_TIME_S:
                raise FileProblem(
                    f"the time of frame {sample.frame}, {sample.time_s:.3g} s, fits no .mcap file",
                    path,
                )
            time_ns = max(round((sample.time_s - start_s) * 1e9), 0)
            for topic, message in _make_messages(sample, time_ns).items():
                writer.write_message(topic, message, time_ns, time_ns, sample.frame)
        writer.finish()


def _make_messages(sample: StageSample, time_ns: int) -> dict[str, Any]:
    """Topic -> message with its time and frame."""
    import cv2
    from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
    from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
    from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

    png = cv2.imencode(".png", sample.pixels[:, :, ::-1])[1].tobytes()
    messages: dict[str, Any] = {
        f"/{sample.name}/image": CompressedImage(format="png", data=png),
        f"/{sample.name}/points": PointCloud(
            point_stride=16,
            fields=_make_point_fields(),
            pose=_make_pose(np.eye(4)),
            data=_pack_points(sample),
        ),
    }
    if sample.depth_mm is not None:
        rows, cols = sample.depth_mm.shape
        depth_m = np.ascontiguousarray(sample.depth_mm * _M_PER_MM, "<f4")
        messages[f"/{sample.name}/depth"] = RawImage(
            width=cols, height=rows, encoding="32FC1", step=4 * cols, data=depth_m.tobytes()
        )
    if sample.target_from_object is not None:
        from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame

        messages[f"/{_OBJECT}"] = PoseInFrame(pose=_make_pose(sample.target_from_object))
    for message in messages.values():
        message.timestamp.FromNanoseconds(time_ns)
        message.frame_id = "target"
    return messages


def _make_point_fields() -> list[Any]:
    from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField as Field

    kinds = [Field.FLOAT32] * 3 + [Field.UINT8] * 4
    offsets = (0, 4, 8, 12, 13, 14, 15)
    return [
        Field(name=n, offset=at, type=kind)
        for n, at, kind in zip(_POINT_FIELDS, offsets, kinds, strict=True)
    ]


def _pack_points(sample: StageSample) -> bytes:
    rows: Any = np.empty(
        len(sample.points_mm), dtype=[("xyz", "<f4", 3), ("rgb", "u1", 3), ("alpha", "u1")]
    )
    rows["xyz"] = sample.points_mm * _M_PER_MM
    rows["rgb"] = sample.rgb
    rows["alpha"] = 255
    return rows.tobytes()


def _make_pose(target_from_object: Doubles) -> Any:
    from foxglove_schemas_protobuf.Pose_pb2 import Pose
    from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
    from foxglove_schemas_protobuf.Vector3_pb2 import Vector3

    angle_vector = rigid.rotation_vector_rad(target_from_object)
    angle = float(np.linalg.norm(angle_vector))
    x, y, z = np.sin(0.5 * angle) / max(angle, 1e-12) * angle_vector
    right, down, out = target_from_object[:3, 3] * _M_PER_MM
    return Pose(
        position=Vector3(x=right, y=down, z=out),
        orientation=Quaternion(x=x, y=y, z=z, w=float(np.cos(0.5 * angle))),
    )


def _make_problem(package: str, suffix: str) -> SettingProblem:
    return SettingProblem(
        f"{suffix} files are written by {package}, which is not installed; pip install {package}"
    )
