"""An object made ready to be registered to, kept for as long as the program runs: its distances and its points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.base.arrays import Doubles
from pipeline.base.memo import Memo
from pipeline.base.progress import SILENT, Progress
from pipeline.engine.digests import digest
from pipeline.geometry.distance_grid import DistanceGrid
from pipeline.geometry.distance_grid_store import distance_grid
from pipeline.geometry.meshes import Mesh
from pipeline.registration.model import Model, sampled

N_MODEL = 30_000  # points on the whole object
_MOST_BYTES = 24 * 1024 * 1024  # two or three objects, their grids counted
_objects: Memo[str, Prepared] = Memo(4, most_bytes=_MOST_BYTES)


@dataclass(frozen=True, slots=True, kw_only=True)
class Prepared:
    """What a registration asks of an object."""

    grid: DistanceGrid
    model: Model
    middle_mm: Doubles  # (3,) of its box


def prepared(mesh: Mesh, seed: int, progress: Progress = SILENT) -> Prepared:
    """The object of a mesh, made or remembered; raises MeshProblem when it has no surface."""
    key = digest((seed, np.asarray(mesh.vertices_mm, np.float64), np.asarray(mesh.triangles, np.int32)))

    def make() -> Prepared:
        model = sampled(mesh, N_MODEL, seed)  # first: it says so when there is no surface
        middle_mm = (mesh.vertices_mm.min(axis=0) + mesh.vertices_mm.max(axis=0)).astype(np.float64) / 2
        return Prepared(grid=distance_grid(mesh, progress), model=model, middle_mm=middle_mm)

    return _objects.of(key, make)
