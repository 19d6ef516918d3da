"""An object made ready to be registered to, kept for as long as the program runs: its distances and its points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.base.arrays import Doubles
from pipeline.base.memo import Memo
from pipeline.base.progress import SILENT, Progress
from pipeline.engine.digests import compute_digest
from pipeline.geometry.distance_grid import DistanceGrid
from pipeline.geometry.distance_grid_store import load_distance_grid
from pipeline.geometry.meshes import Mesh
from pipeline.registration.model import ObjectModel, sample_model

N_MODEL = 30_000  # points on the whole object
_MOST_BYTES = 24 * 1024 * 1024  # two or three objects, their grids counted
_objects: Memo[str, PreparedObject] = Memo(4, most_bytes=_MOST_BYTES)


@dataclass(frozen=True, slots=True, kw_only=True)
class PreparedObject:
    """What a registration asks of an object."""

    grid: DistanceGrid
    model: ObjectModel
    middle_mm: Doubles  # (3,) of its box


def prepare_object(mesh: Mesh, seed: int, progress: Progress = SILENT) -> PreparedObject:
    """The object of a mesh, made or remembered; raises MeshProblem when it has no surface."""
    key = compute_digest((seed, np.asarray(mesh.vertices_mm, np.float64), np.asarray(mesh.triangles, np.int32)))

    def make() -> PreparedObject:
        model = sample_model(mesh, N_MODEL, seed)  # first: it says so when there is no surface
        middle_mm = (mesh.vertices_mm.min(axis=0) + mesh.vertices_mm.max(axis=0)).astype(np.float64) / 2
        return PreparedObject(grid=load_distance_grid(mesh, progress), model=model, middle_mm=middle_mm)

    return _objects.get_or_make(key, make)
