"""Compiled inversion of a slope model, and the picture that its table gives."""
# pyright: basic

import math

import numpy as np
from numba import njit

_FAST = {"contract", "arcp", "nsz", "reassoc"}
_POLISH = 6  # Newton steps at every node after the way there


@njit(cache=True)
def _slopes_at(q, table, powers, degree, out, jacobian):
    """Slopes and their derivatives (2, 3) of one place's colour polynomial `table` (monomials, 2) at colour `q`."""
    out[:] = 0.0
    jacobian[:] = 0.0
    ladder = np.ones((3, degree + 1))
    for k in range(3):
        for d in range(1, degree + 1):
            ladder[k, d] = ladder[k, d - 1] * q[k]
    for m in range(powers.shape[0]):
        i, j, k = powers[m, 0], powers[m, 1], powers[m, 2]
        whole = ladder[0, i] * ladder[1, j] * ladder[2, k]
        red = i * ladder[0, max(i - 1, 0)] * ladder[1, j] * ladder[2, k]
        green = j * ladder[0, i] * ladder[1, max(j - 1, 0)] * ladder[2, k]
        blue = k * ladder[0, i] * ladder[1, j] * ladder[2, max(k - 1, 0)]
        for s in range(2):
            out[s] += table[m, s] * whole
            jacobian[s, 0] += table[m, s] * red
            jacobian[s, 1] += table[m, s] * green
            jacobian[s, 2] += table[m, s] * blue


@njit(cache=True)
def _step(q, missing, jacobian, longest):
    """Move `q` by the shortest colour change that makes up for the missing slopes, at most `longest` long."""
    a = jacobian[0, 0] ** 2 + jacobian[0, 1] ** 2 + jacobian[0, 2] ** 2
    b = jacobian[0, 0] * jacobian[1, 0] + jacobian[0, 1] * jacobian[1, 1] + jacobian[0, 2] * jacobian[1, 2]
    d = jacobian[1, 0] ** 2 + jacobian[1, 1] ** 2 + jacobian[1, 2] ** 2
    held = 1e-6 * (a + d) + 1e-12
    a += held
    d += held
    determinant = a * d - b * b
    first = (d * missing[0] - b * missing[1]) / determinant
    second = (a * missing[1] - b * missing[0]) / determinant
    length = 0.0
    for k in range(3):
        length += (jacobian[0, k] * first + jacobian[1, k] * second) ** 2
    cut = min(1.0, longest / math.sqrt(length + 1e-30))
    for k in range(3):
        q[k] += cut * (jacobian[0, k] * first + jacobian[1, k] * second)


@njit(cache=True)
def invert(tables, powers, degree, grid, steps, out):
    """Turn `out` (places, n, n, 3) into colours whose slopes are grid[j] right and grid[i] down.

    tables (places, monomials, 2). `out` comes as a guess of the colours, or zero. The slopes asked for grow to their
    full size in `steps` Newton steps; of what the last ones give, the colour whose slope is nearest is kept.
    """
    n = grid.shape[0]
    slope = np.empty(2)
    missing = np.empty(2)
    jacobian = np.empty((2, 3))
    q = np.empty(3)
    for p in range(tables.shape[0]):
        for i in range(n):
            for j in range(n):
                for k in range(3):
                    q[k] = out[p, i, j, k]
                nearest = 1e30
                for s in range(1, steps + _POLISH + 1):
                    share = min(s / steps, 1.0)
                    _slopes_at(q, tables[p], powers, degree, slope, jacobian)
                    missing[0] = share * grid[j] - slope[0]
                    missing[1] = share * grid[i] - slope[1]
                    off = missing[0] ** 2 + missing[1] ** 2
                    if share == 1.0 and off < nearest:
                        nearest = off
                        for k in range(3):
                            out[p, i, j, k] = q[k]
                    _step(q, missing, jacobian, 1.0)


@njit(cache=True, fastmath=_FAST)
def look_up(gx, gy, table, slope_max, out):
    """Colour changes out (rows, cols, 3), linear in place and slope between the nodes of table (v, u, n, n, 3)."""
    rows, cols = gx.shape
    nv, nu, n = table.shape[0], table.shape[1], table.shape[2]
    per_slope = np.float32((n - 1) / (2.0 * slope_max))
    for r in range(rows):
        at_v = np.float32((r + 0.5) * (nv - 1) / rows)
        v = min(int(at_v), nv - 2)
        fv = at_v - v
        for c in range(cols):
            x = gx[r, c]
            y = gy[r, c]
            if x == 0.0 and y == 0.0:
                out[r, c, 0] = out[r, c, 1] = out[r, c, 2] = 0.0
                continue
            length = math.sqrt(x * x + y * y)
            if length > slope_max:
                x *= slope_max / length
                y *= slope_max / length
            at_u = np.float32((c + 0.5) * (nu - 1) / cols)
            u = min(int(at_u), nu - 2)
            fu = at_u - u
            at_x = (x + slope_max) * per_slope
            at_y = (y + slope_max) * per_slope
            j = min(max(int(at_x), 0), n - 2)
            i = min(max(int(at_y), 0), n - 2)
            fx = at_x - j
            fy = at_y - i
            for k in range(3):
                total = np.float32(0.0)
                for a in range(2):
                    wa = fv if a else 1 - fv
                    for b in range(2):
                        w = wa * (fu if b else 1 - fu)
                        t = table[v + a, u + b]
                        upper = t[i, j, k] * (1 - fx) + t[i, j + 1, k] * fx
                        lower = t[i + 1, j, k] * (1 - fx) + t[i + 1, j + 1, k] * fx
                        total += w * (upper * (1 - fy) + lower * fy)
                out[r, c, k] = total
