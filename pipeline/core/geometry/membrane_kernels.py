# pyright: basic
"""Compiled loops over height fields: distances of points, and intersections of camera rays."""

from __future__ import annotations

import math

import numpy as np

from pipeline.core.cached_kernels import inline_kernel, kernel


@inline_kernel()
def sample_height(surface, nx, ny, u, v):
    """(z, its change per node to the right, per node down) at grid place (u, v): bilinear, level
    beyond the border.

    `surface` holds z (ny, nx), flat. Branch-free, so that it vectorises; NaN counts as node 0.
    """
    last_x = nx - 1.0
    last_y = ny - 1.0
    # Clamped as floats: a float too large for an integer would give a random cell. NaN compares
    # false.
    u = u if u > 0.0 else 0.0
    v = v if v > 0.0 else 0.0
    u = u if u < last_x else last_x
    v = v if v < last_y else last_y
    i = min(np.int32(u), np.int32(nx - 2))
    j = min(np.int32(v), np.int32(ny - 2))
    a = u - i
    b = v - j
    first = np.uint32(j * np.int32(nx) + i)
    z00 = surface[first]
    z01 = surface[first + np.uint32(1)]
    z10 = surface[first + np.uint32(nx)]
    z11 = surface[first + np.uint32(nx + 1)]
    z = (z00 * (1 - a) + z01 * a) * (1 - b) + (z10 * (1 - a) + z11 * a) * b
    return z, (z01 - z00) * (1 - b) + (z11 - z10) * b, (z10 - z00) * (1 - a) + (z11 - z01) * a


@kernel()
def measure_signed_distance(flat, x0, y0, step, surface, nx, ny, out):
    """Write into `out` (n,) the distance of the points of `flat` (3 n) to the height field,
    negative on the camera's side.

    `surface` holds z (ny, nx), flat. NaN stays NaN.
    """
    per_mm = 1.0 / step
    for k in range(out.shape[0]):
        x = np.float64(flat[3 * k])
        y = np.float64(flat[3 * k + 1])
        z = np.float64(flat[3 * k + 2])
        h, right, down = sample_height(surface, nx, ny, (x - x0) / step, (y - y0) / step)
        hx = right * per_mm
        hy = down * per_mm
        distance = (z - h) / math.sqrt(1.0 + hx * hx + hy * hy)
        out[k] = distance if (x == x) & (y == y) else np.nan


@kernel()
def measure_level_distance(flat, height, out):
    """As `measure_signed_distance`, of a level pad: z - height."""
    for k in range(out.shape[0]):
        x = flat[3 * k]
        y = flat[3 * k + 1]
        z = flat[3 * k + 2]
        out[k] = np.float64(z) - height if (x == x) & (y == y) else np.nan


@kernel(fastmath={"contract", "arcp", "nsz", "reassoc"})
def intersect_rays(surface, nx, ny, x0, y0, step, ray_x, ray_y, far, out):
    """Write z at which each camera ray meets the height field, from the guesses in `out` (rows,
    cols).

    Newton within a bracket that shrinks from the lens and `far`.
    """
    for r in range(ray_y.size):
        for c in range(ray_x.size):
            low = 0.0
            high = far
            z = out[r, c]
            for _ in range(60):
                h, right, down = sample_height(
                    surface, nx, ny, (ray_x[c] * z - x0) / step, (ray_y[r] * z - y0) / step
                )
                above = h - z
                if above > 0.0:
                    low = z
                else:
                    high = z
                if abs(above) < 1e-9:
                    break
                slope = (right * ray_x[c] + down * ray_y[r]) / step - 1.0
                z = z - above / slope if slope < -0.05 else 0.5 * (low + high)
                if not (low < z < high):
                    z = 0.5 * (low + high)
            out[r, c] = z
