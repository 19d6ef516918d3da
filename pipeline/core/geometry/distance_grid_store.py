"""Cache of distance grids: in memory for the process, on disk for the next one."""

from pathlib import Path

import numpy as np

from pipeline.core import disk_store
from pipeline.core.digests import compute_digest
from pipeline.core.geometry.distance_grid import DistanceGrid, build_grid
from pipeline.core.geometry.meshes import Mesh
from pipeline.core.memo import Memo
from pipeline.core.progress import SILENT, Progress

_CODE = tuple(
    f"pipeline.core.geometry.distance_{part}" for part in ("grid", "grid_kernels", "build_kernels")
)
_MAX_BYTES = 12 * 1024 * 1024  # one or two objects; others are read from disk
_grids: Memo[str, DistanceGrid] = Memo(4, most_bytes=_MAX_BYTES)


def load_distance_grid(
    mesh: Mesh, progress: Progress = SILENT, folder: Path | None = None
) -> DistanceGrid:
    """Return the grid of a mesh: cached, read from `folder` (the user's cache), or built and stored
    there.

    Raises MeshProblem when the mesh has no surface.
    """
    made_of = compute_digest(
        (np.asarray(mesh.vertices_mm, np.float64), np.asarray(mesh.triangles, np.int32))
    )

    def make() -> DistanceGrid:
        return disk_store.load_or_make(
            DistanceGrid,
            made_of,
            _CODE,
            lambda: build_grid(mesh, progress),
            folder or "distance_grids",
        )

    return _grids.get_or_make(made_of, make) if folder is None else make()
