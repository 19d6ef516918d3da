# pyright: basic
"""Compiled back-projection and rigid transform in one pass over the source pixels."""

from __future__ import annotations

import numpy as np

from pipeline.core.cached_kernels import kernel


@kernel()
def back_project(depth, contact, stride, ray_x, ray_y, motion, z_min, columns, points, pixel):
    """Write point (n, 3) and flat source pixel (n,) of every usable contact pixel.

    Returns (n, contact pixels).

    z (R (x/z, y/z, 1)) + t with `motion` (3, 4) in float64, rounded once. Pixels without depth, and
    points beyond the float32 range, are skipped. `points` and `pixel` need one spare element,
    `columns` (scratch) one more than columns.
    """
    rows, cols = depth.shape
    n = 0
    total = 0
    for r in range(0, rows, stride):
        any_contact = False
        for c in range(cols):
            any_contact |= contact[r, c]
        if not any_contact:
            continue
        n_row = 0
        for c in range(0, cols, stride):  # branch-free: branches mispredict at the mask border
            columns[n_row] = c
            n_row += contact[r, c]
        total += n_row
        y = ray_y[r]
        # Summed as (a x + b y) + c: another order would round differently.
        for k in range(n_row):
            c = columns[k]
            x = ray_x[c]
            z = np.float64(depth[r, c])
            px = np.float32(z * (motion[0, 0] * x + motion[0, 1] * y + motion[0, 2]) + motion[0, 3])
            py = np.float32(z * (motion[1, 0] * x + motion[1, 1] * y + motion[1, 2]) + motion[1, 3])
            pz = np.float32(z * (motion[2, 0] * x + motion[2, 1] * y + motion[2, 2]) + motion[2, 3])
            points[n, 0] = px
            points[n, 1] = py
            points[n, 2] = pz
            pixel[n] = r * cols + c
            n += (
                (z > z_min)
                & (z < np.inf)
                & (abs(px) < np.inf)
                & (abs(py) < np.inf)
                & (abs(pz) < np.inf)
            )
    return n, total
