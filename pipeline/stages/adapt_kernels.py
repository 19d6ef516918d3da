# pyright: basic
"""Compiled loop of the adapt stage: back-projection and rigid motion in one pass over the source pixels."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, error_model="numpy")
def back_project(depth, contact, stride, ray_x, ray_y, motion, z_min, points, pixel):
    """Write point (n, 3) and flat source pixel (n,) of every usable contact pixel; returns (n, contact pixels seen).

    z (R (x/z, y/z, 1)) + t with `motion` (3, 4) in float64, rounded once. What has no depth, or lies farther than a
    float32 can say, is left out.
    """
    rows, cols = depth.shape
    n, wanted = 0, 0
    for r in range(0, rows, stride):
        y = ray_y[r]
        for c in range(0, cols, stride):
            if not contact[r, c]:
                continue
            wanted += 1
            z = np.float64(depth[r, c])
            if not (z > z_min and z < np.inf):
                continue
            x = ray_x[c]
            for axis in range(3):
                along = motion[axis, 0] * x + motion[axis, 1] * y + motion[axis, 2]
                points[n, axis] = z * along + motion[axis, 3]
            if abs(points[n, 0]) < np.inf and abs(points[n, 1]) < np.inf and abs(points[n, 2]) < np.inf:
                pixel[n] = r * cols + c
                n += 1
    return n, wanted
