"""The paper's released planar evaluation as an answer of the pose stage, for comparison."""

from __future__ import annotations

import numpy as np

from pipeline.base.arrays import freeze
from pipeline.base.progress import SILENT, Progress
from pipeline.geometry.meshes import Mesh
from pipeline.registration.model import Model
from pipeline.registration.planar import Planar, PlanarFit, model_cloud, planar_registration
from pipeline.registration.scene import Scene
from pipeline.registration.starts import starts
from pipeline.values.results import ObjectPose, PoseStep

NOTE = "paper 2D: in-plane turn and shift only; height and tilt are those of the first guess, nothing says what is open"
_FACE = "+z"  # where none is chosen


def planar_pose(
    scene: Scene, mesh: Mesh, model: Model, face: str, n_iterations: int, *, keep_steps: bool,
    progress: Progress = SILENT,
) -> ObjectPose:  # fmt: skip
    """Point-to-point registration of projections along the sensor's axis, from the middle of a face on the contact."""
    chosen = _FACE if face == "auto" else face
    placed = starts(scene, model, chosen, 1)[0].sensor_from_object
    how = Planar(axis="z", n_iterations=n_iterations, starts="sweep", keep_steps=keep_steps)
    fit = planar_registration(model_cloud(mesh), scene.points_mm, how, progress, placed=placed)
    notes = (NOTE, *fit.notes) if face != "auto" else (NOTE, f"face {_FACE} was taken; choose another one", *fit.notes)
    return ObjectPose(
        sensor_from_object=freeze(fit.scene_from_model), covariance=None, observable=None, weak=(),
        rmse_mm=fit.inlier_rmse_mm, fitness=fit.fitness, scene_mm=freeze(scene.points_mm.astype(np.float32)),
        source_index=freeze(scene.pixel), steps=_steps(fit), starts_tried=10, notes=notes,
    )  # fmt: skip


def _steps(fit: PlanarFit) -> tuple[PoseStep, ...]:
    return tuple(
        PoseStep(sensor_from_object=step.scene_from_model, rmse_mm=step.rmse_mm, fitness=fit.fitness)
        for step in fit.steps
    )
