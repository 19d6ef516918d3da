"""Height fields over a sensor's x-y plane: rasterised from a mesh or a depth image, and sampled
along camera rays.

Contact is solved on a lattice in millimetres, where the membrane is a height field; cameras see
along rays. Nothing is rounded to a pixel: triangles are sampled at the lattice's nodes, and rays
meet the bilinear surface to a nanometre.
"""

import numpy as np

from pipeline.core.arrays import Doubles, Indices, Mask, Reals, freeze
from pipeline.core.frozen import frozen
from pipeline.core.geometry.camera import Camera
from pipeline.core.geometry.meshes import make_grid_triangles
from pipeline.core.geometry.rasterisation import rasterise_triangles


@frozen
class Lattice:
    """A square x-y grid in the sensor frame, on which a membrane is a height field z(x, y)."""

    x0_mm: float
    y0_mm: float
    step_mm: float
    shape: tuple[int, int]  # (ny, nx)

    def x_mm(self) -> Doubles:
        """X of every column (nx,)."""
        return self.x0_mm + self.step_mm * np.arange(self.shape[1], dtype=np.float64)

    def y_mm(self) -> Doubles:
        """Y of every row (ny,)."""
        return self.y0_mm + self.step_mm * np.arange(self.shape[0], dtype=np.float64)


def rasterise_depth_image(camera: Camera, depth_mm: Reals, on: Lattice) -> Doubles:
    """Z (ny, nx) in mm of the surface in a depth image (NaN = none), the nearest where it folds.

    +inf without one.
    """
    points = camera.back_project(depth_mm)
    known = np.isfinite(depth_mm)
    height = rasterise_mesh(points.reshape(-1, 3), make_grid_triangles(*known.shape), on)
    between = known[:-1, 1:] & known[1:, :-1]
    upper = between & known[:-1, :-1]
    lower = between & known[1:, 1:]
    joined = np.zeros_like(known)
    joined[:-1, :-1] = upper
    joined[1:, 1:] |= lower
    joined[:-1, 1:] |= upper | lower
    joined[1:, :-1] |= upper | lower
    alone = points[known & ~joined]  # a single pixel between the nodes counts, too
    col, row = ((alone[:, k] - at) / on.step_mm + 0.5 for k, at in enumerate((on.x0_mm, on.y0_mm)))
    inside = (col >= 0) & (col < on.shape[1]) & (row >= 0) & (row < on.shape[0])
    np.minimum.at(
        height, (row[inside].astype(np.intp), col[inside].astype(np.intp)), alone[inside, 2]
    )
    return height


def rasterise_mesh(vertices_mm: Doubles, triangles: Indices, on: Lattice) -> Doubles:
    """Z (ny, nx) of the side of a mesh (in the sensor frame) that faces the camera.

    +inf outside.
    """
    nodes = (vertices_mm - (on.x0_mm, on.y0_mm, 0.0)) / (on.step_mm, on.step_mm, 1.0)
    return rasterise_triangles(nodes, triangles, on.shape)[0]


def intersect_rays(camera: Camera, z_mm: Doubles, on: Lattice, guess_mm: Reals) -> Doubles:
    """Z (rows, cols) where each camera ray meets the surface `z_mm` (ny, nx), level beyond the
    lattice.
    """
    from pipeline.core.geometry.membrane_kernels import intersect_rays

    z = np.array(guess_mm, dtype=np.float64)
    ray_x, ray_y = camera.rays()
    ny, nx = z_mm.shape
    surface = np.ascontiguousarray(z_mm, dtype=np.float64).reshape(-1)
    intersect_rays(
        surface, nx, ny, on.x0_mm, on.y0_mm, on.step_mm, ray_x, ray_y, float(z_mm.max()) + 1.0, z
    )
    return freeze(z)


def sample_mask_at_pixels(camera: Camera, mask: Mask, on: Lattice, depth_mm: Reals) -> Mask:
    """`mask` (ny, nx) at the points that the camera sees at `depth_mm` (rows, cols): of the
    nearest node.
    """
    ray_x, ray_y = camera.rays()
    col = np.rint((depth_mm * ray_x[None, :] - on.x0_mm) / on.step_mm).astype(np.intp)
    row = np.rint((depth_mm * ray_y[:, None] - on.y0_mm) / on.step_mm).astype(np.intp)
    ny, nx = on.shape
    inside = (col >= 0) & (col < nx) & (row >= 0) & (row < ny)
    return freeze(inside & mask[np.clip(row, 0, ny - 1), np.clip(col, 0, nx - 1)])
