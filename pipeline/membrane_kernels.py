# pyright: basic
"""Compiled loop of the membrane test: bilinear height field and first-order distance, one pass, no temporaries."""

from __future__ import annotations

import math

import numpy as np
from numba import njit


@njit(cache=True)
def signed_distance(points, x0, y0, step, z):
    """(n,) distance of points (n, 3) to the height field z (ny, nx), negative on the camera's side; NaN stays NaN."""
    ny, nx = z.shape
    out = np.empty(points.shape[0], dtype=np.float64)
    for k in range(points.shape[0]):
        px, py = points[k, 0], points[k, 1]
        if math.isnan(px) or math.isnan(py):
            out[k] = np.nan
            continue
        # Clamped as floats: what an integer cannot hold would come out as some other cell.
        u = min(max((px - x0) / step, 0.0), nx - 1.0)
        v = min(max((py - y0) / step, 0.0), ny - 1.0)
        i, j = min(int(u), nx - 2), min(int(v), ny - 2)
        a, b = u - i, v - j
        z00, z01, z10, z11 = z[j, i], z[j, i + 1], z[j + 1, i], z[j + 1, i + 1]
        h = (z00 * (1 - a) + z01 * a) * (1 - b) + (z10 * (1 - a) + z11 * a) * b
        hx = ((z01 - z00) * (1 - b) + (z11 - z10) * b) / step
        hy = ((z10 - z00) * (1 - a) + (z11 - z01) * a) / step
        out[k] = (points[k, 2] - h) / math.sqrt(1.0 + hx * hx + hy * hy)
    return out
