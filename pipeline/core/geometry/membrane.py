"""The rest surface of a sensor: its gel or membrane without contact.

A height field over the sensor's x-y plane, z_mm = h(x_mm, y_mm), covers flat pads and domes, and
makes the paper's test SDF(p, M_target) <= 0 exact in sign: a point nearer to the camera than the
surface has pushed it in.

A rest surface may be given as a mesh that is such a height field: an open sheet, or a closed body
whose nearest side faces the camera, in the sensor's frame. Its height is sampled exactly at grid
nodes; the error of the bilinear grid between them is checked. A sheet that folds over itself has no
height field.
"""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pipeline.core.arrays import Doubles, freeze
from pipeline.core.errors import CalibrationError, MeshProblem
from pipeline.core.geometry.camera import MIN_DEPTH_MM, Camera
from pipeline.core.geometry.meshes import Mesh, load_mesh
from pipeline.core.geometry.rasterisation import rasterise_triangles

REST_DEPTH_TOLERANCE_MM = 1e-9  # far below the float32 rounding of a depth image
_MAX_ITERATIONS = 60
MAX_ERROR_MM = 0.05  # of the grid against its mesh: far below the noise of a bubble's depth
_PERCENT = 95  # percent of the cells within that error; the rest are creases, such as a rim
_MOST_NODES = 1_000_000
_ROUNDING = 1e-5  # of a step: vertices of a float32 file are off the grid that made them
_FOLD_MM = 1e-3  # difference of two heights at one (x, y) that counts as a fold


@dataclass(frozen=True, slots=True, kw_only=True)
class Membrane:
    """Height z of the rest surface on a square grid of `step_mm`, bilinear, level beyond its
    border.
    """

    x0_mm: float  # grid column 0
    y0_mm: float  # grid row 0
    step_mm: float
    z_mm: Doubles  # (ny, nx), sensor frame

    def depth_at(self, x_mm: ArrayLike, y_mm: ArrayLike) -> Doubles:
        """Return z of the rest surface at (x, y), same shape as the input."""
        return self._sample(x_mm, y_mm)[0]

    def signed_distance_mm(self, points_mm: ArrayLike) -> Doubles:
        """Return the distance of points (..., 3) to the rest surface, negative on the camera's side
        (pushed in).

        First-order distance (z - h) / sqrt(1 + |grad h|^2): the sign is exact, the size good near
        the surface.
        """
        p = np.asarray(points_mm, dtype=np.float64)
        h, hx, hy = self._sample(p[..., 0], p[..., 1])
        return np.asarray((p[..., 2] - h) / np.sqrt(1.0 + hx * hx + hy * hy))

    def rest_depth_mm(self, camera: Camera) -> Doubles:
        """Return z (rows, cols) where each pixel's ray meets the rest surface.

        Newton on f(z) = h(x z, y z) - z along the ray; raises CalibrationError if a ray never meets
        the surface.
        """
        rx, ry = (
            a for a in np.broadcast_arrays(camera.rays()[0][None, :], camera.rays()[1][:, None])
        )
        z = np.full(camera.shape, float(self.z_mm.mean()))
        for _ in range(_MAX_ITERATIONS):
            h, hx, hy = self._sample(rx * z, ry * z)
            step = (h - z) / np.minimum(hx * rx + hy * ry - 1.0, -0.1)
            z = z - step
            if np.abs(step).max() < REST_DEPTH_TOLERANCE_MM:
                return freeze(z)
        # Newton can hop between two bilinear cells across a crease; the error is far below a
        # micrometre.
        if np.abs(self._sample(rx * z, ry * z)[0] - z).max() < 1e-6:
            return freeze(z)
        raise CalibrationError(
            "some camera rays do not meet the sensor's rest surface; check [rest] and [camera] of "
            "its description"
        )

    def _sample(self, x_mm: ArrayLike, y_mm: ArrayLike) -> tuple[Doubles, Doubles, Doubles]:
        """Return (h, dh/dx, dh/dy): bilinear, clamped to the grid."""
        ny, nx = self.z_mm.shape
        u = np.clip((np.asarray(x_mm, dtype=np.float64) - self.x0_mm) / self.step_mm, 0.0, nx - 1.0)
        v = np.clip((np.asarray(y_mm, dtype=np.float64) - self.y0_mm) / self.step_mm, 0.0, ny - 1.0)
        i = np.minimum(np.nan_to_num(u).astype(np.intp), nx - 2)
        j = np.minimum(np.nan_to_num(v).astype(np.intp), ny - 2)
        a = u - i
        b = v - j
        # a flat index is twice as fast as a pair
        z = self.z_mm.ravel()
        first = j * nx + i
        z00 = z[first]
        z01 = z[first + 1]
        z10 = z[first + nx]
        z11 = z[first + nx + 1]
        h = (z00 * (1 - a) + z01 * a) * (1 - b) + (z10 * (1 - a) + z11 * a) * b
        hx = ((z01 - z00) * (1 - b) + (z11 - z10) * b) / self.step_mm
        hy = ((z10 - z00) * (1 - a) + (z11 - z01) * a) / self.step_mm
        return h, hx, hy


def make_flat_membrane(z_mm: float, half_width_mm: float, half_height_mm: float) -> Membrane:
    """Return a level pad at distance `z_mm` from the camera."""
    step = max(half_width_mm, half_height_mm) / 8.0
    nx = int(np.ceil(2 * half_width_mm / step)) + 1
    ny = int(np.ceil(2 * half_height_mm / step)) + 1
    return Membrane(
        x0_mm=-half_width_mm,
        y0_mm=-half_height_mm,
        step_mm=step,
        z_mm=freeze(np.full((ny, nx), float(z_mm))),
    )


def make_dome_membrane(
    rim_z_mm: float,
    height_mm: float,
    half_width_mm: float,
    half_height_mm: float,
    step_mm: float = 0.5,
) -> Membrane:
    """Return an inflated membrane over an elliptic rim, its apex farthest from the camera.

    h = rim + height (1 - (x/a)^2 - (y/b)^2) solves T lap h = -p exactly on the ellipse, so it is
    the rest shape of a pre-stretched membrane under pressure; outside the rim it is level.
    """
    nx, ny = (2 * int(np.ceil(a / step_mm)) + 1 for a in (half_width_mm, half_height_mm))
    x = (np.arange(nx) - nx // 2) * step_mm
    y = (np.arange(ny) - ny // 2) * step_mm
    bulge = 1.0 - (x[None, :] / half_width_mm) ** 2 - (y[:, None] / half_height_mm) ** 2
    return Membrane(
        x0_mm=float(x[0]),
        y0_mm=float(y[0]),
        step_mm=step_mm,
        z_mm=freeze(rim_z_mm + height_mm * np.maximum(bulge, 0.0)),
    )


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
