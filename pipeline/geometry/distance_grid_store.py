"""Distance grids kept: in memory for as long as the program runs, on disk for the next time.

The folder is the platform's cache of this user. A file that is damaged, of another version or of another mesh is made
again; where nothing can be written, everything works without.
"""

from __future__ import annotations

import contextlib
import threading
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base.arrays import freeze
from pipeline.base.errors import FileProblem
from pipeline.base.files import whole_file
from pipeline.base.progress import SILENT, Progress
from pipeline.engine.digests import digest
from pipeline.geometry.distance_grid import VERSION, DistanceGrid, built
from pipeline.geometry.meshes import Mesh

_KEPT_IN_MEMORY = 4  # grids, 16 MB each
_ARRAYS = ("origin_mm", "coarse_mm", "block", "fine")
_memory: dict[str, DistanceGrid] = {}
_guard = threading.Lock()


def distance_grid(mesh: Mesh, progress: Progress = SILENT, folder: Path | None = None) -> DistanceGrid:
    """The grid of a mesh: remembered, read from `folder` (the user's cache), or built and kept there.

    Raises MeshProblem when the mesh has no surface.
    """
    key = digest((VERSION, np.asarray(mesh.vertices_mm, np.float64), np.asarray(mesh.triangles, np.int32)))
    with _guard:
        known = _memory.get(key) if folder is None else None
    if known is not None:
        return known
    path = (_own_folder() if folder is None else folder) / f"{key}.npz"
    grid = _read(path, key)
    if grid is None:
        grid = built(mesh, progress)
        _write(path, key, grid)
    with _guard:
        _memory[key] = grid
        while len(_memory) > _KEPT_IN_MEMORY:
            _memory.pop(next(iter(_memory)))
    return grid


def _own_folder() -> Path:
    import platformdirs

    return Path(platformdirs.user_cache_dir("tactoscope", appauthor=False)) / "distance_grids"


def _read(path: Path, key: str) -> DistanceGrid | None:
    # Whatever is wrong with a file that can be made again is no news to anybody.
    with contextlib.suppress(OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        with path.open("rb") as opened, np.load(opened, allow_pickle=False) as file:
            if str(file["key"]) != key:
                return None
            arrays: dict[str, Any] = {name: freeze(file[name]) for name in _ARRAYS}
            step_mm, quantum_mm = (float(v) for v in file["steps_mm"])
            notes = tuple(str(note) for note in file["notes"])
        return DistanceGrid(**arrays, step_mm=step_mm, quantum_mm=quantum_mm, notes=notes)
    return None


def _write(path: Path, key: str, grid: DistanceGrid) -> None:
    with contextlib.suppress(FileProblem), whole_file(path, "the distance grid") as file:
        np.savez(
            file, key=np.array(key), steps_mm=np.array([grid.step_mm, grid.quantum_mm]),
            notes=np.array(grid.notes, dtype="U200"), **{name: getattr(grid, name) for name in _ARRAYS},
        )  # fmt: skip
