# pyright: basic
"""Compiled loop of the membrane test: bilinear height field and first-order distance, one pass, no temporaries."""

from __future__ import annotations

import math

import numpy as np
from numba import njit


@njit(cache=True, error_model="numpy")
def signed_distance(flat, x0, y0, step, surface, nx, ny, out):
    """Write into `out` (n,) the distance of the points of `flat` (3 n) to the height field, negative camera's side.

    `surface` holds z (ny, nx), flat. NaN stays NaN. Without branches, so that it runs on vectors of points.
    """
    last_x, last_y, per_mm = nx - 1.0, ny - 1.0, 1.0 / step
    for k in range(out.shape[0]):
        x, y, z = np.float64(flat[3 * k]), np.float64(flat[3 * k + 1]), np.float64(flat[3 * k + 2])
        # Clamped as floats: what an integer cannot hold would come out as some other cell. NaN compares false.
        u, v = (x - x0) / step, (y - y0) / step
        u, v = (u if u > 0.0 else 0.0), (v if v > 0.0 else 0.0)
        u, v = (u if u < last_x else last_x), (v if v < last_y else last_y)
        i, j = min(np.int32(u), np.int32(nx - 2)), min(np.int32(v), np.int32(ny - 2))
        a, b = u - i, v - j
        first = np.uint32(j * np.int32(nx) + i)
        z00, z01 = surface[first], surface[first + np.uint32(1)]
        z10, z11 = surface[first + np.uint32(nx)], surface[first + np.uint32(nx + 1)]
        h = (z00 * (1 - a) + z01 * a) * (1 - b) + (z10 * (1 - a) + z11 * a) * b
        hx = ((z01 - z00) * (1 - b) + (z11 - z10) * b) * per_mm
        hy = ((z10 - z00) * (1 - a) + (z11 - z01) * a) * per_mm
        distance = (z - h) / math.sqrt(1.0 + hx * hx + hy * hy)
        out[k] = distance if (x == x) & (y == y) else np.nan


@njit(cache=True, error_model="numpy")
def level_distance(flat, height, out):
    """As `signed_distance`, of a level pad: z - height."""
    for k in range(out.shape[0]):
        x, y, z = flat[3 * k], flat[3 * k + 1], flat[3 * k + 2]
        out[k] = np.float64(z) - height if (x == x) & (y == y) else np.nan
