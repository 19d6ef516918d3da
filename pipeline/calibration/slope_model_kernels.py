"""Compiled evaluation of the colour-to-slope polynomial."""
# pyright: basic

import math

import numpy as np

from pipeline.core.cached_kernels import FAST, kernel


@kernel(fastmath=FAST)
def evaluate_polynomial(
    change, places, v, where, powers, coefficients, slope_max, row, ladder, product, gx, gy
):
    """Slopes (gx, gy) of every pixel of `where`.

    The powers of v are summed once a row, columns are innermost.

    places (powers of u, cols); coefficients (powers of v, powers of u, colours, 2). Scratch: row
    (powers of u, colours, 2), ladder (3, degree + 1, cols) with ones in its first column, product
    (cols,). gx, gy hold zeros.
    """
    rows, cols = where.shape
    n_place = coefficients.shape[0]
    n_colour = powers.shape[0]
    for r in range(rows):
        n_wanted = 0
        for c in range(cols):
            n_wanted += where[r, c]
        if n_wanted == 0:
            continue
        for i in range(n_place):  # element-wise: a slice assignment adds 6 s of compilation
            for m in range(n_colour):
                x = np.float32(0.0)
                y = np.float32(0.0)
                for j in range(n_place - 1, -1, -1):
                    x = x * v[r] + coefficients[j, i, m, 0]
                    y = y * v[r] + coefficients[j, i, m, 1]
                row[i, m, 0] = x
                row[i, m, 1] = y
        for k in range(3):
            for d in range(1, ladder.shape[1]):
                for c in range(cols):
                    ladder[k, d, c] = ladder[k, d - 1, c] * change[r, c, k]
        for m in range(n_colour):
            first = powers[m, 0]
            second = powers[m, 1]
            third = powers[m, 2]
            for c in range(cols):
                product[c] = ladder[0, first, c] * ladder[1, second, c] * ladder[2, third, c]
            for i in range(n_place):
                x = row[i, m, 0]
                y = row[i, m, 1]
                for c in range(cols):
                    q = product[c] * places[i, c]
                    gx[r, c] += x * q
                    gy[r, c] += y * q
        for c in range(cols):
            length = math.sqrt(gx[r, c] * gx[r, c] + gy[r, c] * gy[r, c])
            cut = slope_max / length if length > slope_max else np.float32(1.0)
            cut *= where[r, c]
            gx[r, c] *= cut
            gy[r, c] *= cut
