# pyright: basic
"""Compiled loop of the adapt stage: back-projection and rigid motion in one pass over the source pixels."""

from __future__ import annotations

import numpy as np

from pipeline.base.cached_kernels import kernel


@kernel()
def back_project(depth, contact, stride, ray_x, ray_y, motion, z_min, wanted, points, pixel):
    """Write point (n, 3) and flat source pixel (n,) of every usable contact pixel; returns (n, contact pixels seen).

    z (R (x/z, y/z, 1)) + t with `motion` (3, 4) in float64, rounded once. What has no depth, or lies farther than a
    float32 can say, is left out. `points` and `pixel` need room for one more than there are, `wanted` (written over)
    for one more than there are columns.
    """
    rows, cols = depth.shape
    n, total = 0, 0
    for r in range(0, rows, stride):
        there = False
        for c in range(cols):
            there |= contact[r, c]
        if not there:
            continue
        found = 0
        for c in range(0, cols, stride):  # no branch: the mask's border is where guesses fail
            wanted[found] = c
            found += contact[r, c]
        total += found
        y = ray_y[r]
        # (a x + b y) + c, in this very order: the sum of the row's share alone would round otherwise.
        for k in range(found):
            c = wanted[k]
            x, z = ray_x[c], np.float64(depth[r, c])
            px = np.float32(z * (motion[0, 0] * x + motion[0, 1] * y + motion[0, 2]) + motion[0, 3])
            py = np.float32(z * (motion[1, 0] * x + motion[1, 1] * y + motion[1, 2]) + motion[1, 3])
            pz = np.float32(z * (motion[2, 0] * x + motion[2, 1] * y + motion[2, 2]) + motion[2, 3])
            points[n, 0], points[n, 1], points[n, 2] = px, py, pz
            pixel[n] = r * cols + c
            n += (z > z_min) & (z < np.inf) & (abs(px) < np.inf) & (abs(py) < np.inf) & (abs(pz) < np.inf)
    return n, total
