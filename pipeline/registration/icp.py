"""Point-to-plane and point-to-point ICP by Open3D, which is loaded on first use (it takes more than a second)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from pipeline import rigid
from pipeline.arrays import Doubles, freeze
from pipeline.meshes import Mesh
from pipeline.registration.model import Model
from pipeline.registration.scene import Scene, in_reach
from pipeline.stages.results import PoseStep

_CONVERGED = 1e-6  # relative change of fitness and rmse
_DECIMALS = 9  # the order of Open3D's parallel sums is not fixed; what is kept of them is
_SETTLED = 1e-6  # largest change of an entry, mm: far below what a depth image can show
_REACH = 1.5  # model points within this many search distances of the scene can take part


@dataclass(frozen=True, slots=True, kw_only=True)
class Fit:
    """Where a registration ended."""

    sensor_from_object: Doubles  # (4, 4) mm
    rmse_mm: float
    fitness: float
    steps: tuple[PoseStep, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Registration:
    """How one run of ICP is done."""

    method: str  # "point-to-plane" or "point-to-point"
    n_iterations: int
    max_distance_mm: float
    n_points: int  # of the scene
    keep_steps: bool = False


def register(scene: Scene, model: Model, start: Doubles, how: Registration) -> Fit:
    """Register felt points to the model from `start` (sensor_from_object); rmse is over distances to its samples."""
    icp = _open3d().pipelines.registration
    source = _cloud(scene.points_mm[:: max(1, len(scene.points_mm) // how.n_points)])
    target = _cloud_of_model(in_reach(scene, model, start, _REACH * how.max_distance_mm + 0.5))
    estimation = (
        icp.TransformationEstimationPointToPlane()
        if how.method == "point-to-plane"
        else icp.TransformationEstimationPointToPoint()
    )
    object_from_sensor = rigid.invert(start)
    steps: list[PoseStep] = []
    n_runs, n_each = (how.n_iterations, 1) if how.keep_steps else (1, how.n_iterations)
    criteria = icp.ICPConvergenceCriteria(_CONVERGED, _CONVERGED, n_each)
    result: Any = None
    for _run in range(n_runs):
        before = result
        result = icp.registration_icp(source, target, how.max_distance_mm, object_from_sensor, estimation, criteria)
        moved = _tidy(result.transformation)
        if how.keep_steps:
            steps.append(_step(moved, result))
        settled = before is not None and _settled(object_from_sensor, moved)
        object_from_sensor = moved
        if settled:
            break
    return Fit(
        sensor_from_object=rigid.invert(object_from_sensor),
        rmse_mm=round(float(result.inlier_rmse), _DECIMALS),
        fitness=round(float(result.fitness), _DECIMALS),
        steps=tuple(steps),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Surface:
    """A mesh that distances are measured to exactly, not to its samples."""

    _scene: Any  # Open3D's, which is untyped

    def residual(self, points_mm: Doubles, sensor_from_object: Doubles, within_mm: float) -> tuple[float, float]:
        """(rms distance in mm of the points within `within_mm` of the placed object, their share of all)."""
        in_object = rigid.apply(rigid.invert(sensor_from_object), points_mm).astype(np.float32)
        distance = self._scene.compute_distance(_open3d().core.Tensor(in_object)).numpy()
        near = distance <= within_mm
        rms = float(np.sqrt(np.mean(distance[near].astype(np.float64) ** 2))) if near.any() else math.nan
        return round(rms, _DECIMALS), float(near.mean())


def surface(mesh: Mesh) -> Surface:
    """The mesh, ready to be measured to."""
    o3d = _open3d()
    scene = o3d.t.geometry.RaycastingScene()
    vertices = o3d.core.Tensor(mesh.vertices_mm.astype(np.float32))
    scene.add_triangles(vertices, o3d.core.Tensor(mesh.triangles.astype(np.uint32)))
    return Surface(_scene=scene)


def _open3d() -> Any:
    import open3d

    return cast("Any", open3d)


def _cloud(points_mm: Doubles) -> Any:
    o3d = _open3d()
    return o3d.geometry.PointCloud(o3d.utility.Vector3dVector(np.ascontiguousarray(points_mm)))


def _cloud_of_model(model: Model) -> Any:
    cloud = _cloud(model.points_mm)
    cloud.normals = _open3d().utility.Vector3dVector(np.ascontiguousarray(model.normals))
    return cloud


def _tidy(transformation: Any) -> Doubles:
    """Rounded below a millionth of a millimetre, its rotation made orthonormal again."""
    return rigid.checked(np.round(np.asarray(transformation), _DECIMALS), "the registration's result")


def _settled(a: Doubles, b: Doubles) -> bool:
    return bool(np.abs(a - b).max() < _SETTLED)


def _step(object_from_sensor: Doubles, result: Any) -> PoseStep:
    return PoseStep(
        sensor_from_object=freeze(rigid.invert(object_from_sensor)),
        rmse_mm=round(float(result.inlier_rmse), _DECIMALS),
        fitness=round(float(result.fitness), _DECIMALS),
    )
