"""A sensor's rest surface given as a mesh: where it is a height field over x-y, it becomes a `Membrane`.

The mesh is an open sheet, or a closed body whose nearest side faces the camera, in the sensor's frame. Its height is
read off exactly at the nodes of a lattice; between them the lattice is bilinear, and how far that is from the mesh is
checked. A sheet that folds over itself has no height field.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base.arrays import Doubles, freeze
from pipeline.base.errors import MeshProblem
from pipeline.geometry.camera import MIN_DEPTH_MM
from pipeline.geometry.membrane import Membrane
from pipeline.geometry.meshes import Mesh, load_mesh

MAX_ERROR_MM = 0.05  # of a lattice against its mesh: far below the noise of a bubble's depth reading
_USUAL = 95  # percent of the cells that must be followed so well; creases, such as a rim, take the rest
_MOST_NODES = 1_000_000
_SAME = 1e-5  # of a step: vertices of a float32 file lie beside the lattice that made them
_FOLD_MM = 1e-3  # two heights at one (x, y) this far apart are a fold


def load_membrane(path: Path, unit: str = "auto", step_mm: float = 0.5) -> Membrane:
    """The rest surface of an STL, PLY or OBJ file; raises FileProblem or MeshProblem in one sentence."""
    mesh = load_mesh(path, unit)
    try:
        return make_mesh_membrane(mesh, step_mm)
    except MeshProblem as error:
        raise MeshProblem(f"{error}: '{path}'") from error


def make_mesh_membrane(mesh: Mesh, step_mm: float = 0.5) -> Membrane:
    """The mesh's nearest surface, seen along z, on a lattice of `step_mm`; level beyond the mesh's outline.

    Raises MeshProblem when the mesh reaches behind the camera, folds over itself, or is not followed to MOST_ERROR_MM
    (creases such as a rim aside) by a lattice of that step.
    """
    low, high = mesh.vertices_mm.min(axis=0), mesh.vertices_mm.max(axis=0)
    if not low[2] > MIN_DEPTH_MM:
        raise MeshProblem(f"the rest surface reaches to z = {low[2]:.3g} mm, behind the camera; move it to z > 0")
    nx, ny = (max(2, math.ceil((high[k] - low[k]) / step_mm - _SAME) + 1) for k in (0, 1))
    if nx * ny > _MOST_NODES:
        raise MeshProblem(f"a lattice of {step_mm:g} mm has {nx * ny:,} nodes on this rest surface; use a larger step")
    x, y = low[0] + np.arange(nx) * step_mm, low[1] + np.arange(ny) * step_mm
    # The last nodes may lie beside the mesh by a rounding, or by part of a step: there its border goes on.
    x_mm, y_mm = np.meshgrid(np.minimum(x, high[0]), np.minimum(y, high[1]))
    heights = _heights(mesh, x_mm, y_mm, step_mm)
    if not np.isfinite(heights).any():
        raise MeshProblem("the rest surface stands on edge: seen along z it covers nothing; check its axes")
    surface = Membrane(x0_mm=float(x[0]), y0_mm=float(y[0]), step_mm=step_mm, z_mm=freeze(_continued(heights)))
    error_mm = compute_lattice_error_mm(mesh, surface)
    if error_mm > MAX_ERROR_MM:
        raise MeshProblem(
            f"a lattice of {step_mm:g} mm follows the rest surface to {error_mm:.2g} mm only; use a smaller step"
        )
    return surface


def _heights(mesh: Mesh, x_mm: Doubles, y_mm: Doubles, step_mm: float) -> Doubles:
    """Z of the mesh's nearest surface at each (x, y), NaN where there is none; raises MeshProblem where it folds."""
    from pipeline.geometry.mesh_membrane_kernels import sample_mesh_heights

    nearest, farthest = np.full(x_mm.size, np.nan), np.full(x_mm.size, np.nan)
    sample_mesh_heights(
        np.ascontiguousarray(mesh.vertices_mm), np.ascontiguousarray(mesh.triangles), x_mm.ravel(), y_mm.ravel(),
        (float(x_mm[0, 0]), float(y_mm[0, 0])), step_mm, x_mm.shape, nearest, farthest,
    )  # fmt: skip
    folded = int(np.count_nonzero(farthest - nearest > _FOLD_MM))
    if folded:
        raise MeshProblem(
            f"the rest surface folds over itself at {folded:,} places seen along z; "
            "keep the sheet that the camera sees, without walls or a back"
        )
    return nearest.reshape(x_mm.shape)


def _continued(heights: Doubles) -> Doubles:
    """The height of the nearest known node where the mesh ends."""
    from scipy.ndimage import distance_transform_edt

    missing = ~np.isfinite(heights)
    if not missing.any():
        return heights
    nearest: Any = distance_transform_edt(missing, return_distances=False, return_indices=True)
    return heights[tuple(nearest)]


def compute_lattice_error_mm(mesh: Mesh, surface: Membrane) -> float:
    """Difference along z between a mesh and its height field that 95 % of the cells stay within, at their middles."""
    ny, nx = surface.z_mm.shape
    x_mm, y_mm = np.meshgrid(
        surface.x0_mm + (np.arange(nx) + 0.5) * surface.step_mm, surface.y0_mm + (np.arange(ny) + 0.5) * surface.step_mm
    )
    off = np.abs(_heights(mesh, x_mm, y_mm, surface.step_mm) - surface.depth_at(x_mm, y_mm))
    known = off[np.isfinite(off)]
    return float(np.percentile(known, _USUAL)) if known.size else 0.0
