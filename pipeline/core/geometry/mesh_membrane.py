"""Convert a rest surface given as a mesh, which is a height field over x-y, to a `Membrane`.

The mesh is an open sheet, or a closed body whose nearest side faces the camera, in the sensor's
frame. Its height is sampled exactly at grid nodes; the error of the bilinear grid between them is
checked. A sheet that folds over itself has no height field.
"""

import math
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.core.arrays import Doubles, freeze
from pipeline.core.errors import MeshProblem
from pipeline.core.geometry.camera import MIN_DEPTH_MM
from pipeline.core.geometry.membrane import Membrane
from pipeline.core.geometry.meshes import Mesh, load_mesh
from pipeline.core.geometry.rasterisation import rasterise_triangles

MAX_ERROR_MM = 0.05  # of the grid against its mesh: far below the noise of a bubble's depth
_PERCENT = 95  # percent of the cells within that error; the rest are creases, such as a rim
_MOST_NODES = 1_000_000
_ROUNDING = 1e-5  # of a step: vertices of a float32 file are off the grid that made them
_FOLD_MM = 1e-3  # difference of two heights at one (x, y) that counts as a fold


def load_membrane(path: Path, unit: str = "auto", step_mm: float = 0.5) -> Membrane:
    """Load the rest surface of an STL, PLY or OBJ file; raises FileProblem or MeshProblem."""
    mesh = load_mesh(path, unit)
    try:
        return make_mesh_membrane(mesh, step_mm)
    except MeshProblem as error:
        raise MeshProblem(f"{error}: '{path}'") from error


def make_mesh_membrane(mesh: Mesh, step_mm: float = 0.5) -> Membrane:
    """Return the mesh's nearest surface along z on a grid of `step_mm`.

    Level beyond the mesh's outline.

    Raises MeshProblem when the mesh reaches behind the camera, folds over itself, or differs from
    the grid by more than MAX_ERROR_MM (except at creases such as a rim).
    """
    low = mesh.vertices_mm.min(axis=0)
    high = mesh.vertices_mm.max(axis=0)
    if not low[2] > MIN_DEPTH_MM:
        raise MeshProblem(
            f"the rest surface reaches to z = {low[2]:.3g} mm, behind the camera; move it to z > 0"
        )
    nx, ny = (max(2, math.ceil((high[k] - low[k]) / step_mm - _ROUNDING) + 1) for k in (0, 1))
    if nx * ny > _MOST_NODES:
        raise MeshProblem(
            f"a grid of {step_mm:g} mm has {nx * ny:,} nodes on this rest surface; use a larger "
            "step"
        )
    x = low[0] + np.arange(nx) * step_mm
    y = low[1] + np.arange(ny) * step_mm
    # The last nodes may be outside the mesh by rounding or part of a step: its border continues
    # there.
    columns, rows = ((at[:-1], np.minimum(at[-1:], high[k])) for k, at in enumerate((x, y)))
    heights = np.block(
        [[_heights(mesh, some_x, some_y, step_mm) for some_x in columns] for some_y in rows]
    )
    if not np.isfinite(heights).any():
        raise MeshProblem("the rest surface is parallel to z and covers no area; check its axes")
    surface = Membrane(
        x0_mm=float(x[0]), y0_mm=float(y[0]), step_mm=step_mm, z_mm=freeze(_extend_border(heights))
    )
    error_mm = compute_lattice_error_mm(mesh, surface)
    if error_mm > MAX_ERROR_MM:
        raise MeshProblem(
            f"a grid of {step_mm:g} mm differs from the rest surface by {error_mm:.2g} mm; use a "
            "smaller step"
        )
    return surface


def _heights(mesh: Mesh, x_mm: Doubles, y_mm: Doubles, step_mm: float) -> Doubles:
    """Z (ny, nx) of the mesh's nearest surface at nodes of a grid, else NaN.

    Raises MeshProblem where it folds.
    """
    nodes = (mesh.vertices_mm - (x_mm[0], y_mm[0], 0.0)) / (step_mm, step_mm, 1.0)
    nearest, farthest = (
        side
        * rasterise_triangles(nodes * (1.0, 1.0, side), mesh.triangles, (len(y_mm), len(x_mm)))[0]
        for side in (1.0, -1.0)
    )
    folded = int(np.count_nonzero(farthest - nearest > _FOLD_MM))
    if folded:
        raise MeshProblem(
            f"the rest surface folds over itself at {folded:,} places seen along z; "
            "keep the sheet that the camera sees, without walls or a back"
        )
    return np.where(np.isfinite(nearest), nearest, np.nan)


def _extend_border(heights: Doubles) -> Doubles:
    """Fill missing nodes with the height of the nearest known node."""
    from scipy.ndimage import distance_transform_edt

    missing = ~np.isfinite(heights)
    if not missing.any():
        return heights
    nearest: Any = distance_transform_edt(missing, return_distances=False, return_indices=True)
    return heights[tuple(nearest)]


def compute_lattice_error_mm(mesh: Mesh, surface: Membrane) -> float:
    """Return the 95th percentile over cells of |z| difference between mesh and height field, at
    their centres.
    """
    ny, nx = surface.z_mm.shape
    x_mm, y_mm = (
        at + (np.arange(n) + 0.5) * surface.step_mm
        for at, n in ((surface.x0_mm, nx), (surface.y0_mm, ny))
    )
    off = np.abs(
        _heights(mesh, x_mm, y_mm, surface.step_mm) - surface.depth_at(*np.meshgrid(x_mm, y_mm))
    )
    known = off[np.isfinite(off)]
    return float(np.percentile(known, _PERCENT)) if known.size else 0.0
