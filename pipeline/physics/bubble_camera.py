"""Between the bubble's lattice and what its depth camera sees, exact along every ray."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Doubles, Mask, freeze
from pipeline.physics.bubble import Lattice
from pipeline.sensors.spec import SensorSpec


def ceiling_from_depth(sensor: SensorSpec, depth_mm: NDArray[np.floating], on: Lattice) -> Doubles:
    """Height over the rim plane (ny, nx) of the surface in a depth image; +inf where it shows none.

    The pixels are joined to triangles in space and sampled at the lattice's nodes, so nothing is rounded to a pixel.
    """
    from pipeline.physics.bubble_kernels import lay_over

    height = np.full(on.shape, np.inf)
    ray_x, ray_y = sensor.camera.rays()
    lay_over(np.asarray(depth_mm, np.float64), ray_x, ray_y, on.x0_mm, on.y0_mm, on.step_mm, height)
    return height - rim_z_mm(sensor)


def depth_from_deviation(sensor: SensorSpec, deviation_mm: NDArray[np.floating], on: Lattice) -> Doubles:
    """Z (rows, cols) where each camera ray meets the membrane; the rest depth itself where nothing deviates."""
    from pipeline.physics.bubble_kernels import look

    z = np.array(sensor.rest_depth_mm, dtype=np.float64)
    if not deviation_mm.any():
        return freeze(z)
    surface = rest_z_mm(sensor, on) + deviation_mm
    ray_x, ray_y = sensor.camera.rays()
    look(surface, on.x0_mm, on.y0_mm, on.step_mm, ray_x, ray_y, 0.0, float(surface.max()) + 1.0, z)
    return freeze(z)


def rim_z_mm(sensor: SensorSpec) -> float:
    """Distance of the rim plane from the camera."""
    return float(sensor.membrane.z_mm.min())


def rest_z_mm(sensor: SensorSpec, on: Lattice) -> Doubles:
    """Z (ny, nx) of the untouched membrane at the lattice's nodes."""
    return sensor.membrane.depth_at(on.x_mm()[None, :], on.y_mm()[:, None])


def seen_at_pixels(sensor: SensorSpec, on: Lattice, mask: Mask, depth_mm: NDArray[np.floating]) -> Mask:
    """`mask` (ny, nx) of the lattice at the points (rows, cols) that the camera sees: the nearest node decides."""
    ray_x, ray_y = sensor.camera.rays()
    col = np.rint((depth_mm * ray_x[None, :] - on.x0_mm) / on.step_mm).astype(np.intp)
    row = np.rint((depth_mm * ray_y[:, None] - on.y0_mm) / on.step_mm).astype(np.intp)
    ny, nx = on.shape
    inside = (col >= 0) & (col < nx) & (row >= 0) & (row < ny)
    return freeze(inside & mask[np.clip(row, 0, ny - 1), np.clip(col, 0, nx - 1)])
