"""Open3D's point-to-plane ICP on sampled points, as in the paper, as a method of the pose stage."""

import math
from dataclasses import replace
from typing import Any

import numpy as np

from pipeline.core.arrays import Doubles, freeze
from pipeline.core.errors import CalibrationError
from pipeline.core.frozen import frozen
from pipeline.core.geometry import rigid
from pipeline.core.geometry.meshes import Mesh, sample_surface
from pipeline.core.progress import SILENT, Progress
from pipeline.core.values.results import ObjectPose, PoseStep
from pipeline.stages.pose.registration.scene import list_starts
from pipeline.stages.pose.registration.search import PoseSearch

NOTE = (
    "icp: the result with the largest fitness, then the least rmse; pose ambiguity is not estimated"
)
N_MODEL_POINTS = 20_000  # sampled on the object, as in benchmarks/pose.py
# iterations from each start; starts that are iterated to the end
_QUICK = 3
_N_REFINED = 6
_SETTLED = 1e-6  # Open3D's own relative change of fitness and rmse that ends its iterations


@frozen
class _Icp:
    """Scene and object point clouds of Open3D."""

    source: Any
    target: Any
    max_distance_mm: float

    def iterate(self, start: Doubles, n_iterations: int) -> PoseStep:
        """Run `n_iterations` from a sensor_from_object.

        The scene points move, the object is fixed.
        """
        import open3d

        registration = open3d.pipelines.registration
        found = registration.registration_icp(
            self.source,
            self.target,
            self.max_distance_mm,
            rigid.invert(start),
            registration.TransformationEstimationPointToPlane(),
            registration.ICPConvergenceCriteria(_SETTLED, _SETTLED, n_iterations),
        )
        try:
            pose = rigid.invert(
                rigid.validate_rigid(np.array(found.transformation), "the result of ICP")
            )
        except CalibrationError:
            # An underdetermined system yields a matrix that is not rigid: the start is discarded.
            return PoseStep(sensor_from_object=freeze(start), rmse_mm=math.inf, fitness=0.0)
        return PoseStep(
            sensor_from_object=freeze(pose),
            rmse_mm=float(found.inlier_rmse),
            fitness=float(found.fitness),
            max_correspondence_mm=self.max_distance_mm,
        )


def register_icp(
    search: PoseSearch,
    mesh: Mesh,
    face: str,
    n_starts: int,
    seed: int,
    progress: Progress = SILENT,
) -> ObjectPose:
    """ICP from the starts of our own search, a few iterations each, the best of them to
    convergence.

    Points beyond the search distance have no correspondence. The face of the object is set by the
    starts only.
    """
    import open3d

    scene = search.scene
    points_mm, normals = sample_surface(mesh, N_MODEL_POINTS, seed)
    clouds = [
        open3d.geometry.PointCloud(open3d.utility.Vector3dVector(np.array(p)))
        for p in (scene.points_mm, points_mm)
    ]
    clouds[1].normals = open3d.utility.Vector3dVector(np.array(normals))
    icp = _Icp(source=clouds[0], target=clouds[1], max_distance_mm=search.max_distance_mm)
    # the first start of each orientation has the centre of its face on the contact's centre
    starts = {
        start.group: start.sensor_from_object
        for start in reversed(list_starts(scene, search.object.model, face, n_starts))
    }
    # Open3D sums on several threads in varying order; one thread is deterministic.
    n_threads = open3d.utility.get_max_threads()
    open3d.utility.set_max_threads(1)
    try:
        history = _find_best_history(
            icp, list(reversed(starts.values())), search.n_iterations, progress
        )
    finally:
        open3d.utility.set_max_threads(n_threads)
    best = history[-1]
    if not best.fitness > 0:
        return replace(
            scene.no_pose,
            notes=("icp: no start has points within the search distance of the object",),
        )
    return replace(
        scene.no_pose,
        sensor_from_object=best.sensor_from_object,
        rmse_mm=best.rmse_mm,
        fitness=best.fitness,
        steps=tuple(history) if search.keep_steps else (),
        stop_reason=_describe_stop(len(history) - 1, search.n_iterations),
        starts_tried=len(starts),
        notes=(NOTE,),
    )


def _find_best_history(
    icp: _Icp, starts: list[Doubles], n_iterations: int, progress: Progress
) -> list[PoseStep]:
    """A few iterations from each start, then single iterations from the best of them."""
    quick: list[PoseStep] = []
    for k, start in enumerate(starts):
        progress.step(k / (len(starts) + 1), f"ICP from start {k + 1} of {len(starts)}")
        quick.append(icp.iterate(start, _QUICK))
    progress.step(1.0 - 1.0 / (len(starts) + 1), "ICP from the best starts")
    histories = [
        _iterate_to_end(icp, first_step, n_iterations)
        for first_step in sorted(quick, key=_rank_step)[:_N_REFINED]
    ]
    return min(histories, key=lambda steps: _rank_step(steps[-1]))


def _describe_stop(n: int, max_iterations: int) -> str:
    if n < max_iterations:
        return "converged: the last iteration changed the rms by less than a millionth"
    return f"stopped at the limit of {n} iterations"


def _rank_step(step: PoseStep) -> tuple[float, float]:
    return -step.fitness, step.rmse_mm


def _iterate_to_end(icp: _Icp, first_step: PoseStep, n_iterations: int) -> list[PoseStep]:
    steps = [first_step]
    for _ in range(n_iterations):
        steps.append(icp.iterate(steps[-1].sensor_from_object, 1))
        if abs(steps[-1].rmse_mm - steps[-2].rmse_mm) <= _SETTLED * max(
            steps[-2].rmse_mm, _SETTLED
        ):
            break
    return steps
