"""Height fields over a sensor's x-y plane: rasterised from a mesh or a depth image, and sampled along camera rays.

Contact is solved on a lattice in millimetres, where the membrane is a height field; cameras see along rays. Nothing is
rounded to a pixel: triangles are sampled at the lattice's nodes, and rays meet the bilinear surface to a nanometre.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Doubles, Indices, Mask, freeze
from pipeline.geometry.camera import Camera


@dataclass(frozen=True, slots=True, kw_only=True)
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


def rasterise_depth_image(camera: Camera, depth_mm: NDArray[np.floating], on: Lattice) -> Doubles:
    """Z (ny, nx) in mm of the surface in a depth image (NaN = none), the nearest where it folds; +inf without one."""
    from pipeline.physics.lattice_kernels import lower_to_depth_image

    height = np.full(on.shape, np.inf)
    ray_x, ray_y = camera.rays()
    joined = np.zeros(depth_mm.shape, np.bool_)
    lower_to_depth_image(np.asarray(depth_mm, np.float64), ray_x, ray_y, on.x0_mm, on.y0_mm, on.step_mm, joined, height)
    return height


def rasterise_mesh(vertices_mm: Doubles, triangles: Indices, on: Lattice) -> Doubles:
    """Z (ny, nx) of the side of a mesh (in the sensor frame) that faces the camera; +inf outside."""
    from pipeline.physics.lattice_kernels import lower_to_mesh

    height = np.full(on.shape, np.inf)
    nodes = np.array(vertices_mm, dtype=np.float64)
    nodes[:, :2] = (nodes[:, :2] - (on.x0_mm, on.y0_mm)) / on.step_mm
    lower_to_mesh(nodes, triangles, height)
    return height


def render_mesh_depth(vertices_mm: Doubles, triangles: Indices, camera: Camera) -> Doubles:
    """Z (rows, cols) of the side of a mesh (in front of the camera, in its frame) that each pixel sees; NaN outside.

    1 / z is linear in the image, so that triangles are rasterised as over a lattice.
    """
    from pipeline.physics.lattice_kernels import lower_to_mesh

    x, y, z = vertices_mm.T
    nodes = np.stack([camera.fx_px * x / z + camera.cx_px, camera.fy_px * y / z + camera.cy_px, -1.0 / z], axis=-1)
    nearness = np.full(camera.shape, np.inf)
    lower_to_mesh(nodes, triangles, nearness)
    return freeze(np.where(np.isfinite(nearness), -1.0 / nearness, np.nan))


def intersect_rays(camera: Camera, z_mm: Doubles, on: Lattice, guess_mm: NDArray[np.floating]) -> Doubles:
    """Z (rows, cols) where each camera ray meets the surface `z_mm` (ny, nx), level beyond the lattice."""
    from pipeline.geometry.membrane_kernels import intersect_rays

    z = np.array(guess_mm, dtype=np.float64)
    ray_x, ray_y = camera.rays()
    ny, nx = z_mm.shape
    surface = np.ascontiguousarray(z_mm, dtype=np.float64).reshape(-1)
    intersect_rays(surface, nx, ny, on.x0_mm, on.y0_mm, on.step_mm, ray_x, ray_y, float(z_mm.max()) + 1.0, z)
    return freeze(z)


def sample_mask_at_pixels(camera: Camera, mask: Mask, on: Lattice, depth_mm: NDArray[np.floating]) -> Mask:
    """`mask` (ny, nx) at the points that the camera sees at `depth_mm` (rows, cols): of the nearest node."""
    ray_x, ray_y = camera.rays()
    col = np.rint((depth_mm * ray_x[None, :] - on.x0_mm) / on.step_mm).astype(np.intp)
    row = np.rint((depth_mm * ray_y[:, None] - on.y0_mm) / on.step_mm).astype(np.intp)
    ny, nx = on.shape
    inside = (col >= 0) & (col < nx) & (row >= 0) & (row < ny)
    return freeze(inside & mask[np.clip(row, 0, ny - 1), np.clip(col, 0, nx - 1)])
