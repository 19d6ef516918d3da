"""How long does the pose of a usual touch take, searched anew and followed from the touch before? Beside Open3D's ICP.

    python -m benchmarks.pose_stage

The touches of the sample recording, translated from DIGIT to GelSlim; the object's grid is cached, as it is from the
second touch on. `icp` is the same stage with that method.
Errors are the largest displacement of a vertex of the object (MSSD), medians over the touches.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarks.harness.results import BenchmarkResult, PlotPoint
from benchmarks.harness.text_report import print_result
from benchmarks.harness.timing import Requirement, Timing, build_measurement, time_in_turns
from pipeline.metrics.symmetric_pose_error import compute_symmetric_error
from pipeline.stages.pose.signed_distances import PoseParams, estimate_pose, estimate_pose_icp, track_pose
from pipeline.translation.translate import Request, open_translation
from pipeline.values.results import DepthMap, ObjectPose

ROOT = Path(__file__).resolve().parents[1]
_FRAMES = tuple(range(4, 13))
_SEARCHED, _FOLLOWED, _ICP = "searched anew", "followed", "icp"
_MOST_MM = 0.5  # MSSD, of an object 24 mm long


def touches() -> tuple[object, list[tuple[DepthMap, np.ndarray]]]:
    """(the object's mesh, generated touches with their true sensor_from_object)."""
    recording = ROOT / "sample_data/recordings/first_touch.h5"
    opened = open_translation(Request(recording=recording, source="digit", target="gelslim"))
    graph, found = opened.build_graph(), []
    for index in _FRAMES:
        touch = graph.evaluate(["touch_depth"], opened.read_inputs(index), {})["touch_depth"].output
        _, truth = opened.read_target_observation(index)
        found.append((touch, truth.sensor_from_object))
    return opened.mesh, found


def measure() -> BenchmarkResult:
    mesh, felt = touches()
    params = PoseParams()
    searched = [estimate_pose(touch, mesh, params) for touch, _ in felt]
    calls = {
        _SEARCHED: lambda k: estimate_pose(felt[k][0], mesh, params),
        _FOLLOWED: lambda k: track_pose(felt[k][0], mesh, params, searched[k - 1].sensor_from_object,
                                       alternatives=searched[k - 1].alternatives),
        _ICP: lambda k: estimate_pose_icp(felt[k][0], mesh, PoseParams(keep_steps=False)),
    }  # fmt: skip
    after = range(1, len(felt))
    errors = {n: float(np.median([_off(call(k), felt[k][1], mesh) for k in after])) for n, call in calls.items()}
    times = _timed({n: calls[n] for n in (_SEARCHED, _FOLLOWED)}, after, 5)
    times |= _timed({_ICP: calls[_ICP]}, after[:2], 1)  # a second each
    n_followed = sum("followed from the touch before" in calls[_FOLLOWED](k).notes for k in after)
    return BenchmarkResult(
        title="Pose of the touches of a recording", unit="mm",
        rows=tuple(
            build_measurement(f"pose stage, {name}", ours=times[name], ours_error=errors[name], unit="mm",
                bar=Requirement(max_ms=60.0, max_error=_MOST_MM), peer="Open3D ICP from the same starts", peer_timing=times[_ICP],
                peer_error=errors[_ICP])
            for name in (_SEARCHED, _FOLLOWED)
        ),
        points=tuple(PlotPoint(method=n, ms=times[n].median_ms, error=errors[n], ours=n != _ICP) for n in calls),
        notes=(f"{n_followed} of {len(after)} touches were followed, the others searched",),
    )  # fmt: skip


def _off(found: ObjectPose, truth: np.ndarray, mesh: object) -> float:
    if found.sensor_from_object is None:
        return np.inf
    return compute_symmetric_error(found.sensor_from_object, truth, mesh, None, found.scene_mm.mean(axis=0)).mssd_mm


def _timed(calls, frames: range, runs: int) -> dict[str, Timing]:
    raced = [time_in_turns({n: (lambda c=c, k=k: c(k)) for n, c in calls.items()}, runs=runs) for k in frames]
    return {
        n: Timing(median_ms=float(np.median([r[n].median_ms for r in raced])), p95_ms=max(r[n].p95_ms for r in raced))
        for n in calls
    }


if __name__ == "__main__":
    print_result(measure())
