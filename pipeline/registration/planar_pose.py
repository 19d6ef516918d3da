"""The paper's released planar evaluation as a method of the pose stage, for comparison."""

import numpy as np

from pipeline.base.arrays import freeze
from pipeline.base.progress import SILENT, Progress
from pipeline.geometry.meshes import Mesh, sample_surface
from pipeline.registration.model import ObjectModel
from pipeline.registration.planar import N_MODEL, SWEEP_DEG, register_planar
from pipeline.registration.scene import ContactScene
from pipeline.registration.starts import list_starts
from pipeline.values.results import ObjectPose

NOTE = "paper 2D: in-plane turn and shift only; height and tilt keep their initial values, no uncertainty is known"
_FACE = "+z"  # default face


def estimate_planar_pose(
    scene: ContactScene, mesh: Mesh, model: ObjectModel, face: str, n_iterations: int, *, keep_steps: bool,
    progress: Progress = SILENT,
) -> ObjectPose:  # fmt: skip
    """Register projections along the sensor's axis point to point; the centre of a face starts on the contact."""
    chosen = _FACE if face == "auto" else face
    placed = list_starts(scene, model, chosen, 1)[0].sensor_from_object
    model_mm = sample_surface(mesh, N_MODEL, 0)[0]
    fit = register_planar(model_mm, scene.points_mm, placed, n_iterations, progress, keep_steps=keep_steps)
    notes = (NOTE, *fit.notes) if face != "auto" else (NOTE, f"face {_FACE} by default; choose the face", *fit.notes)
    return ObjectPose(
        sensor_from_object=freeze(fit.scene_from_model), covariance=None, observable=None, weak_directions=(),
        rmse_mm=fit.inlier_rmse_mm, fitness=fit.fitness, scene_mm=freeze(scene.points_mm.astype(np.float32)),
        source_index=freeze(scene.pixel), steps=fit.steps, stop_reason=fit.stop_reason, starts_tried=len(SWEEP_DEG),
        notes=notes,
    )  # fmt: skip
