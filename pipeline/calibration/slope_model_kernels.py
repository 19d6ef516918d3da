"""Compiled evaluation of the colour-to-slope polynomial."""
# pyright: basic

import math

import numpy as np

from pipeline.base.cached_kernels import FAST, kernel


@kernel(fastmath=FAST)
def evaluate_polynomial(change, u, v, where, powers, coefficients, slope_max, row, ladder, gx, gy):
    """Slopes of every pixel of `where`; the powers of v are summed once a row.

    row (places, colours, 2): scratch. ladder (3, degree + 1): ones in the first column, the others scratch.
    """
    rows, cols = where.shape
    n_place = coefficients.shape[0]
    n_colour = powers.shape[0]
    for r in range(rows):
        started = False
        for c in range(cols):
            if not where[r, c]:
                continue
            if not started:
                started = True
                for i in range(n_place):  # element-wise: a slice assignment adds 6 s of compilation
                    for m in range(n_colour):
                        row[i, m, 0] = coefficients[n_place - 1, i, m, 0]
                        row[i, m, 1] = coefficients[n_place - 1, i, m, 1]
                for j in range(n_place - 2, -1, -1):
                    for i in range(n_place):
                        for m in range(n_colour):
                            row[i, m, 0] = row[i, m, 0] * v[r] + coefficients[j, i, m, 0]
                            row[i, m, 1] = row[i, m, 1] * v[r] + coefficients[j, i, m, 1]
            for k in range(3):
                for d in range(1, ladder.shape[1]):
                    ladder[k, d] = ladder[k, d - 1] * change[r, c, k]
            x = np.float32(0.0)
            y = np.float32(0.0)
            for m in range(n_colour):
                a = row[n_place - 1, m, 0]
                b = row[n_place - 1, m, 1]
                for i in range(n_place - 2, -1, -1):
                    a = a * u[c] + row[i, m, 0]
                    b = b * u[c] + row[i, m, 1]
                q = ladder[0, powers[m, 0]] * ladder[1, powers[m, 1]] * ladder[2, powers[m, 2]]
                x += a * q
                y += b * q
            length = math.sqrt(x * x + y * y)
            cut = slope_max / length if length > slope_max else np.float32(1.0)
            gx[r, c] = x * cut
            gy[r, c] = y * cut
