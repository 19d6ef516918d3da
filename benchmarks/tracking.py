"""How far does tracking without a mesh drift, next to point-to-plane ICP of the same contacts?

    python -m benchmarks.tracking [depth method]

Simulated slides over 10 mm and turns by 30 degrees of six objects on three sensors, depth by
default unless another method is named. ICP (Open3D) registers each frame's contact to the first
one's from the pose of the frame before.
"""

from __future__ import annotations

import math
import sys

import numpy as np

from benchmarks.harness.results import BenchmarkResult
from benchmarks.harness.text_report import print_result
from benchmarks.harness.timing import Requirement, Timing, build_measurement
from benchmarks.scenes.depth_helpers import build_reader
from pipeline.core.geometry import rigid
from pipeline.core.values.frames import TactileFrame
from pipeline.lab.tracking.track_recording import compute_error, track_frames
from pipeline.physics.sensor_images import render_sensor_image
from pipeline.physics.simulation import shapes
from pipeline.physics.simulation.poses import compute_lowest_mm
from pipeline.physics.simulation.press import simulate_press
from pipeline.sensors.spec import load_sensor

_OBJECTS = ("ellipse", "letters", "cross", "wave", "star", "curve")
# deepest point in mm below the gels' plane
_SENSORS = {"gelslim": 0.6, "digit": 0.6, "soft_bubble": 6.6}
_N_FRAMES = 31
_ICP_DISTANCE_MM = 1.0


def measure(method: str = "") -> BenchmarkResult:
    rows = []
    for sensor, depth_mm in _SENSORS.items():
        figures = [
            _measure_motion(sensor, depth_mm, name, kind, method)
            for name in _OBJECTS
            for kind in ("slide", "turn")
        ]
        taken, drift, turned, lost, icp, icp_turned = (
            np.array(column) for column in zip(*figures, strict=True)
        )
        taken_ms = Timing(median_ms=float(np.median(taken)), p95_ms=float(np.max(taken)))
        for unit, ours, peer, bar in (("mm", drift, icp, 0.2), ("deg", turned, icp_turned, 1.0)):
            rows.append(
                build_measurement(
                    f"{sensor}: median of the largest drift, {int(lost.sum())} frames lost",
                    unit=unit,
                    peer="Open3D point-to-plane",
                    ours=taken_ms,
                    ours_error=float(np.median(ours)),
                    peer_error=float(np.median(peer)),
                    bar=Requirement(max_ms=25, max_error=bar),
                )
            )
    notes = (
        f"depth by {method}; slides of 10 mm and turns of 30 degrees of {', '.join(_OBJECTS)}",
    )
    return BenchmarkResult(
        title="Tracking without a mesh", unit="mm", rows=tuple(rows), notes=notes
    )


def _measure_motion(sensor: str, depth_mm: float, name: str, kind: str, method: str):
    """(ms a frame, drift in mm, in degrees, lost frames, drift of ICP in mm, in degrees)."""
    import time

    spec = load_sensor(sensor)
    mesh = shapes.make_shape(name).mesh
    read = build_reader(method)
    still = render_sensor_image(
        spec, np.zeros(spec.camera.shape, np.float32), spec.rest_depth_mm, 999
    )
    maps = []
    poses = []
    for index in range(_N_FRAMES):
        press = simulate_press(
            mesh, _pose(mesh, depth_mm, kind, index / (_N_FRAMES - 1)), spec, seed=index
        )
        maps.append(
            read(TactileFrame(sensor=sensor, image=press.image, reference=still, index=index), spec)
        )
        poses.append(press.sensor_from_object)
    started = time.process_time()
    track = track_frames(range(_N_FRAMES), maps.__getitem__)
    taken_ms = 1e3 * (time.process_time() - started) / _N_FRAMES
    error = compute_error(track, poses.__getitem__)
    return (taken_ms, error.drift_mm, error.drift_deg, track.n_lost, *_follow_by_icp(maps, poses))


def _pose(mesh, depth_mm: float, kind: str, share: float):
    """The object's pose: 5 mm right and 5 mm down on a slide, 30 degrees on a turn."""
    along = 10.0 * share if kind == "slide" else 2.5
    angle = 0.2 if kind == "slide" else math.radians(30.0 * share - 15.0)
    pose = rigid.translation(
        min(along, 5.0) - 2.5, max(along - 5.0, 0.0) - 2.5 * (kind == "slide"), 0.0
    )
    pose = pose @ rigid.rotation((0.01, -0.01, 0.0)) @ rigid.rotation((0.0, 0.0, angle))
    pose[2, 3] = -depth_mm - compute_lowest_mm(rigid.apply(pose, mesh.vertices_mm), mesh.triangles)
    return pose


def _follow_by_icp(maps, poses) -> tuple[float, float]:
    """Largest drift (mm, degrees) of point-to-plane ICP."""
    import open3d as o3d

    def cloud(depth):
        points = depth.camera.back_project(depth.depth_mm)[
            depth.contact & np.isfinite(depth.depth_mm)
        ]
        made = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
        made.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(radius=0.5, max_nn=30))
        return made

    first = cloud(maps[0])
    motion = np.eye(4)
    worst = [0.0, 0.0]
    for depth, pose in zip(maps[1:], poses[1:], strict=True):
        now = cloud(depth)
        motion = o3d.pipelines.registration.registration_icp(
            first,
            now,
            _ICP_DISTANCE_MM,
            motion,
            o3d.pipelines.registration.TransformationEstimationPointToPlane(),
        ).transformation
        off = np.asarray(motion) @ rigid.invert(pose @ rigid.invert(poses[0]))
        centre = np.asarray(now.points).mean(axis=0)
        worst = [
            max(worst[0], float(np.linalg.norm(rigid.apply(off, centre) - centre))),
            max(worst[1], rigid.rotation_angle_deg(off)),
        ]
    return worst[0], worst[1]


if __name__ == "__main__":
    print_result(measure(*sys.argv[1:2]))
