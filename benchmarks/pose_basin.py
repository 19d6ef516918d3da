"""How many poses are found from bad initial guesses? Our registration and the stage as it runs, against Open3D.

    python -m benchmarks.pose_basin

The tool of the question "pose". First guesses are off by an angle of 20 degrees (standard deviation) about a random
axis and by 2.5 mm (standard deviation) along each axis. Found means within 0.1 mm and 0.5 degrees of the contact's
middle. Errors are the shares, in percent, that were not found. The registration from one start and Open3D's get the
4,000 points of that question; the stage gets what a gel of 160 x 120 pixels feels of the tool, pressed in by 1.2 mm
under up to 4 degrees, with 0.03 mm of noise, and the first guess as the pose of the touch before. Open3D's row next to
it is of the same touches and guesses.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks import pose
from benchmarks.harness.results import BenchmarkResult, PlotPoint
from benchmarks.harness.text_report import print_result
from benchmarks.harness.timing import Requirement, build_measurement
from pipeline.geometry import rigid
from pipeline.geometry.camera import Camera
from pipeline.stages.pose.signed_distances import PoseParams, track_pose
from pipeline.values.results import DepthMap

TRIALS, TOUCHES, _TURN_DEG, _SHIFT_MM = 200, 24, 20.0, 2.5
_FIRST_SEED = 90_000  # none of these contacts was looked at while anything here was chosen
_FOUND_MM, _FOUND_DEG = 0.1, 0.5
_CAMERA = Camera(rows=120, cols=160, fx_px=120.0, fy_px=120.0, cx_px=79.5, cy_px=59.5)  # 0.17 mm a pixel
_REST_MM, _DEEP_MM, _TILT_DEG, _SLID_MM = 20.0, 1.2, 4.0, 2.0


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseTrial:
    """A touch, where the tool truly is, and a first guess."""

    touch: DepthMap
    points: np.ndarray
    truth: np.ndarray
    start: np.ndarray


def simulate_trial(of: pose.Tool, seed: int) -> PoseTrial:
    """The tool's outermost side pressed into a gel that follows it wherever they overlap."""
    rng = np.random.default_rng([seed, 11])
    turn = rigid.rotation([0.0, 0.0, rng.uniform(0.0, 2 * np.pi)])
    turn = rigid.rotation(np.deg2rad([*rng.uniform(-_TILT_DEG, _TILT_DEG, 2), 0.0])) @ turn
    lowest_mm = float((of.points @ turn[2, :3]).min())
    truth = rigid.translation(*rng.uniform(-_SLID_MM, _SLID_MM, 2), _REST_MM - _DEEP_MM - lowest_mm) @ turn
    depth = np.minimum(_seen(of, truth), _REST_MM)
    contact = depth < _REST_MM
    depth = (depth + pose.NOISE_MM * rng.standard_normal(depth.shape)).astype(np.float32)
    touch = DepthMap(
        indentation_mm=np.float32(_REST_MM) - depth, depth_mm=depth,
        contact=contact, camera=_CAMERA,
        source_index=np.arange(contact.size, dtype=np.int32).reshape(contact.shape),
    )  # fmt: skip
    points = _CAMERA.back_project(depth)[contact]
    middle = points.mean(axis=0)
    off = rigid.translation(*(middle + rng.standard_normal(3) * _SHIFT_MM)) @ rigid.rotation(
        np.deg2rad(rng.standard_normal() * _TURN_DEG) * pose.unit(rng)
    )
    return PoseTrial(touch=touch, points=points, truth=truth, start=off @ rigid.translation(*-middle) @ truth)


def _seen(of: pose.Tool, truth: np.ndarray) -> np.ndarray:
    """Depth of the tool in each pixel, infinity next to it."""
    import open3d

    scene, core = open3d.t.geometry.RaycastingScene(), open3d.core
    placed = rigid.apply(truth, of.mesh.vertices_mm).astype(np.float32)
    scene.add_triangles(core.Tensor(placed), core.Tensor(of.mesh.triangles.astype(np.uint32)))
    x, y = _CAMERA.rays()
    ray = np.stack([*np.broadcast_arrays(x[None, :], y[:, None]), np.ones(_CAMERA.shape)], axis=-1)
    rays = np.concatenate([np.zeros_like(ray), ray], axis=-1).astype(np.float32)
    return scene.cast_rays(core.Tensor(rays))["t_hit"].numpy().astype(np.float64)


def register_with_stage(of: pose.Tool, it: PoseTrial) -> np.ndarray:
    """Followed from the first guess or, where that does not fit, searched."""
    found = track_pose(it.touch, of.mesh, PoseParams(keep_steps=False), it.start).sensor_from_object
    return it.start if found is None else found


def measure() -> BenchmarkResult:
    it = pose.tool()
    trials = [
        pose.trial(it, seed, _TURN_DEG, _SHIFT_MM, spread=True) for seed in range(_FIRST_SEED, _FIRST_SEED + TRIALS)
    ]
    touches = [simulate_trial(it, seed) for seed in range(_FIRST_SEED, _FIRST_SEED + TOUCHES)]
    open3d = pose.open3d_icp(it)
    one = {
        "ours, one start": lambda t: pose.ours(it, t.points, t.start),
        "Open3D point-to-plane, one start": lambda t: open3d(t.points, t.start),
    }
    stage = {
        "ours, the stage": lambda t: register_with_stage(it, t),
        "Open3D point-to-plane, the stage's touches": lambda t: open3d(t.points, t.start),
    }
    rows, points, notes = [], [], []
    for calls, cases, what, bar in (
        (one, trials, "basin, one start", Requirement(min_error_ratio=1.0)),
        (stage, touches, "basin, the stage", Requirement(max_error=5.0, min_error_ratio=1.0)),
    ):
        missed = {n: 100.0 * float(np.mean([not _found(c(t), t) for t in cases])) for n, c in calls.items()}
        times = pose.time_over_trials(calls, cases[:16])
        ours, peer = calls
        rows.append(build_measurement(what, ours=times[ours], ours_error=missed[ours], unit="% missed", peer=peer,
                        peer_timing=times[peer], peer_error=missed[peer], bar=bar))  # fmt: skip
        points += [
            PlotPoint(method=n, ms=times[n].median_ms, error=missed[n], ours=n.startswith("ours")) for n in calls
        ]
        notes += [f"{n}: found {100 - missed[n]:.1f} % of {len(cases)}" for n in calls]
    return BenchmarkResult(
        title="Poses found from 20 degrees and 2.5 mm off", unit="% missed", rows=tuple(rows), points=tuple(points),
        notes=tuple(notes),
    )  # fmt: skip


def _found(pose_: np.ndarray, of: pose.Trial | PoseTrial) -> bool:
    mm, deg = pose.error(pose_, of)
    return mm < _FOUND_MM and deg < _FOUND_DEG


if __name__ == "__main__":
    print_result(measure())
