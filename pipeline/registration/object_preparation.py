"""Prepare objects for registration: distance grid and surface points, cached for the life of the process."""

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
_MAX_BYTES = 12 * 1024 * 1024  # of the cache: one or two objects with their grids
_objects: Memo[str, PreparedObject] = Memo(4, most_bytes=_MAX_BYTES)


@dataclass(frozen=True, slots=True, kw_only=True)
class PreparedObject:
    """An object's distance grid and surface points."""

    grid: DistanceGrid
    model: ObjectModel
    middle_mm: Doubles  # (3,) centre of its bounding box


def prepare_object(mesh: Mesh, seed: int, progress: Progress = SILENT) -> PreparedObject:
    """Return the prepared object of a mesh, cached; raises MeshProblem when it has no surface."""
    key = compute_digest((seed, np.asarray(mesh.vertices_mm, np.float64), np.asarray(mesh.triangles, np.int32)))

    def make() -> PreparedObject:
        model = sample_model(mesh, N_MODEL, seed)  # first: it raises when there is no surface
        middle_mm = (mesh.vertices_mm.min(axis=0) + mesh.vertices_mm.max(axis=0)).astype(np.float64) / 2
        return PreparedObject(grid=load_distance_grid(mesh, progress), model=model, middle_mm=middle_mm)

    return _objects.get_or_make(key, make)
