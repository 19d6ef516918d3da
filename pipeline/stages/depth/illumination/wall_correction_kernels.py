"""Compiled normal equations of the shapes by which a surface is moved as a whole
(`wall_correction`).
"""
# pyright: basic

import numpy as np

from pipeline.core.cached_kernels import FAST, kernel


@kernel(fastmath=FAST)
def accumulate_normal_equations(gx, gy, target_x, target_y, xx, xy, yy, line, normal, pull):
    """Write the normal equations of the sum of shapes that brings the first shape's slopes to the
    target slopes.

    gx, gy (n, rows, cols): the shapes' slopes; target_x, target_y and the weights xx, xy, yy (rows,
    cols). normal (n, n) and pull (n,) are doubles: the weighted slopes of one shape times those of
    another, and times the residual. line (2, cols): scratch.
    """
    n, rows, cols = gx.shape
    normal[:] = 0.0
    pull[:] = 0.0
    for row in range(rows):
        r = np.uint64(row)
        for a in range(n):
            one = np.uint64(a)
            total = np.float32(0.0)
            for i in range(cols):
                c = np.uint64(i)
                x = xx[r, c] * gx[one, r, c] + xy[r, c] * gy[one, r, c]
                y = xy[r, c] * gx[one, r, c] + yy[r, c] * gy[one, r, c]
                line[0, c] = x
                line[1, c] = y
                total += x * (target_x[r, c] - gx[0, r, c]) + y * (target_y[r, c] - gy[0, r, c])
            pull[one] += total
            for b in range(a + 1):
                other = np.uint64(b)
                total = np.float32(0.0)
                for i in range(cols):
                    c = np.uint64(i)
                    total += line[0, c] * gx[other, r, c] + line[1, c] * gy[other, r, c]
                normal[one, other] += total
    for a in range(n):
        for b in range(a):
            normal[b, a] = normal[a, b]
