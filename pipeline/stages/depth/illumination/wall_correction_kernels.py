"""Compiled sums by which shapes of a surface are weighed against slopes that are not all as sure (`walls`)."""
# pyright: basic

import numpy as np

from pipeline.base.cached_kernels import FAST, kernel


@kernel(fastmath=FAST)
def accumulate_normal_equations(gx, gy, wanted_x, wanted_y, xx, xy, yy, line, normal, pull):
    """Write the normal equations of which sum of shapes has what the slopes of the first one lack of those wanted.

    gx, gy (n, rows, cols): the shapes' slopes; the others (rows, cols), of which xx, xy, yy are the weights. normal
    (n, n) and pull (n,) double: the slopes of one shape times those of another, and times what is lacking. line
    (2, cols): written over.
    """
    n, rows, cols = gx.shape
    normal[:] = 0.0
    pull[:] = 0.0
    for row in range(rows):
        r = np.uint64(row)
        for a in range(n):
            one, total = np.uint64(a), np.float32(0.0)
            for i in range(cols):
                c = np.uint64(i)
                x = xx[r, c] * gx[one, r, c] + xy[r, c] * gy[one, r, c]
                y = xy[r, c] * gx[one, r, c] + yy[r, c] * gy[one, r, c]
                line[0, c], line[1, c] = x, y
                total += x * (wanted_x[r, c] - gx[0, r, c]) + y * (wanted_y[r, c] - gy[0, r, c])
            pull[one] += total
            for b in range(a + 1):
                other, total = np.uint64(b), np.float32(0.0)
                for i in range(cols):
                    c = np.uint64(i)
                    total += line[0, c] * gx[other, r, c] + line[1, c] * gy[other, r, c]
                normal[one, other] += total
    for a in range(n):
        for b in range(a):
            normal[b, a] = normal[a, b]
