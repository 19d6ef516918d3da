"""Open3D's point-to-plane ICP on sampled points, as the paper registers objects, as an answer of the pose stage."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from pipeline.base.arrays import Doubles, freeze
from pipeline.base.errors import CalibrationError
from pipeline.base.progress import SILENT, Progress
from pipeline.geometry import rigid
from pipeline.geometry.meshes import Mesh, sample_surface
from pipeline.registration.model import ObjectModel
from pipeline.registration.scene import ContactScene
from pipeline.registration.starts import InitialPose, list_starts
from pipeline.values.results import ObjectPose, PoseStep

NOTE = "icp: the start of most points near the object, then of least rmse; nothing says what is open"
N_MODEL_POINTS = 20_000  # points that the object is sampled at, as in benchmarks/pose.py
_QUICK, _N_REFINED = 3, 6  # iterations from each start; starts that are registered to the end
_SETTLED = 1e-6  # Open3D's own relative change of fitness and rmse that ends its iterations


@dataclass(frozen=True, slots=True, kw_only=True)
class _Icp:
    """A felt cloud and an object's cloud, as Open3D wants them."""

    source: Any
    target: Any
    max_distance_mm: float

    def iterate(self, start: Doubles, n_iterations: int) -> PoseStep:
        """Where so many iterations lead from a sensor_from_object; the felt points are moved, the object stays."""
        import open3d

        registration = open3d.pipelines.registration
        found = registration.registration_icp(
            self.source, self.target, self.max_distance_mm, rigid.invert(start),
            registration.TransformationEstimationPointToPlane(),
            registration.ICPConvergenceCriteria(_SETTLED, _SETTLED, n_iterations),
        )  # fmt: skip
        try:
            pose = rigid.invert(rigid.validate_rigid(np.array(found.transformation), "the result of ICP"))
        except CalibrationError:
            # A system that nothing determines is solved to something that is no motion: such a start is worth nothing.
            return PoseStep(sensor_from_object=freeze(start), rmse_mm=math.inf, fitness=0.0)
        return PoseStep(
            sensor_from_object=freeze(pose), rmse_mm=float(found.inlier_rmse), fitness=float(found.fitness),
            max_correspondence_mm=self.max_distance_mm,
        )  # fmt: skip


def register_icp(
    scene: ContactScene, mesh: Mesh, model: ObjectModel, *, face: str, n_starts: int, n_iterations: int, max_distance_mm: float,
    seed: int, keep_steps: bool, progress: Progress = SILENT,
) -> ObjectPose:  # fmt: skip
    """ICP from the first guesses of our own search, a few iterations each, the most promising to the end.

    Points beyond `max_distance_mm` have no partner. The side of the object is told by the starts alone.
    """
    import open3d

    points_mm, normals = sample_surface(mesh, N_MODEL_POINTS, seed)
    clouds = [
        open3d.geometry.PointCloud(open3d.utility.Vector3dVector(np.array(p))) for p in (scene.points_mm, points_mm)
    ]
    clouds[1].normals = open3d.utility.Vector3dVector(np.array(normals))
    icp = _Icp(source=clouds[0], target=clouds[1], max_distance_mm=max_distance_mm)
    tried = _one_a_group(list_starts(scene, model, face, n_starts))
    # Open3D adds up on as many threads as there are, each time in another order.
    n_threads = open3d.utility.get_max_threads()
    open3d.utility.set_max_threads(1)
    try:
        way = _best_way(icp, tried, n_iterations, progress)
    finally:
        open3d.utility.set_max_threads(n_threads)
    best = way[-1]
    known = best.fitness > 0
    return ObjectPose(
        sensor_from_object=best.sensor_from_object if known else None, covariance=None, observable=None, weak_directions=(),
        rmse_mm=best.rmse_mm if known else math.nan, fitness=best.fitness,
        scene_mm=freeze(scene.points_mm.astype(np.float32)), source_index=freeze(scene.pixel),
        steps=tuple(way) if keep_steps else (), stop_reason=_stopped(len(way) - 1, n_iterations) if known else "",
        starts_tried=len(tried),
        notes=(NOTE,) if known else ("icp: no point lies within the search distance of the object from any start",),
    )  # fmt: skip


def _best_way(icp: _Icp, tried: list[InitialPose], n_iterations: int, progress: Progress) -> list[PoseStep]:
    """A few iterations from each start, then on from the best of these, one by one."""
    quick: list[PoseStep] = []
    for k, start in enumerate(tried):
        progress.step(k / (len(tried) + 1), f"ICP from start {k + 1} of {len(tried)}")
        quick.append(icp.iterate(start.sensor_from_object, _QUICK))
    progress.step(1.0 - 1.0 / (len(tried) + 1), "ICP from the best of these")
    ways = [_way(icp, begun, n_iterations) for begun in sorted(quick, key=_worth)[:_N_REFINED]]
    return min(ways, key=lambda steps: _worth(steps[-1]))


def _stopped(n: int, most: int) -> str:
    if n < most:
        return "settled: the last iteration changed the rms by less than a millionth of it"
    return f"ended after {n} iterations, as many as are allowed"


def _worth(step: PoseStep) -> tuple[float, float]:
    return -step.fitness, step.rmse_mm


def _one_a_group(tried: list[InitialPose]) -> list[InitialPose]:
    """The first start of each orientation, the middle of its face on the contact's."""
    groups: dict[tuple[str, int], InitialPose] = {}
    for start in tried:
        groups.setdefault(start.group, start)
    return list(groups.values())


def _way(icp: _Icp, begun: PoseStep, n_iterations: int) -> list[PoseStep]:
    steps = [begun]
    for _ in range(n_iterations):
        steps.append(icp.iterate(steps[-1].sensor_from_object, 1))
        if abs(steps[-1].rmse_mm - steps[-2].rmse_mm) <= _SETTLED * max(steps[-2].rmse_mm, _SETTLED):
            break
    return steps
