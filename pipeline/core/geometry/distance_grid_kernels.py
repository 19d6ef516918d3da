# pyright: basic
"""Compiled loops of the distance grid: look-up of distances, and inside or outside by grid
lines.
"""

from __future__ import annotations

import math

import numpy as np

from pipeline.core.cached_kernels import inner_kernel, kernel

CELLS = 8  # fine cells along a block's edge
NODES = CELLS + 1


@inner_kernel()
def _cell(v, at, over_y, over_x, a, b, c):
    """Value and slopes per cell of a flat grid at its node `at` plus (a, b, c), strides (over_x,
    over_y, 1).
    """
    # Unsigned indices need no test for negative ones, which would cost as much as the look-up.
    p00 = np.uint64(at)
    p01 = np.uint64(at + over_y)
    p10 = np.uint64(at + over_x)
    p11 = np.uint64(at + over_x + over_y)
    one = np.uint64(1)
    v000 = float(v[p00])
    v001 = float(v[p00 + one])
    v010 = float(v[p01])
    v011 = float(v[p01 + one])
    v100 = float(v[p10])
    v101 = float(v[p10 + one])
    v110 = float(v[p11])
    v111 = float(v[p11 + one])
    d00 = v100 - v000
    d01 = v101 - v001
    d10 = v110 - v010
    d11 = v111 - v011
    x00 = v000 + d00 * a
    x01 = v001 + d01 * a
    x10 = v010 + d10 * a
    x11 = v011 + d11 * a
    f0 = x10 - x00
    f1 = x11 - x01
    y0 = x00 + f0 * b
    y1 = x01 + f1 * b
    e0 = d00 + (d10 - d00) * b
    e1 = d01 + (d11 - d01) * b
    return y0 + (y1 - y0) * c, e0 + (e1 - e0) * c, f0 + (f1 - f0) * c, y1 - y0


@inner_kernel()
def look_up(x, y, z, grid):
    """Signed distance (mm) and its gradient at one point of the object frame.

    Grids are flat, C order.
    """
    origin, step, shape, coarse, block, fine, quantum = grid
    nx, ny, nz = shape
    per_mm = 1.0 / step
    u = (x - origin[0]) * per_mm
    v = (y - origin[1]) * per_mm
    w = (z - origin[2]) * per_mm
    # Clamped as floats: a float too large for an integer would give a random cell.
    cu = min(max(u, 0.0), nx - 1.0)
    cv = min(max(v, 0.0), ny - 1.0)
    cw = min(max(w, 0.0), nz - 1.0)
    i = min(int(cu), nx - 2)
    j = min(int(cv), ny - 2)
    k = min(int(cw), nz - 2)
    a = cu - i
    b = cv - j
    c = cw - k
    number = np.int64(block[np.uint64((i * (ny - 1) + j) * (nz - 1) + k)])
    if number >= 0:
        a = a * CELLS
        b = b * CELLS
        c = c * CELLS
        fi = min(int(a), CELLS - 1)
        fj = min(int(b), CELLS - 1)
        fk = min(int(c), CELLS - 1)
        at = ((number * NODES + fi) * NODES + fj) * NODES + fk
        d, gx, gy, gz = _cell(fine, at, NODES, NODES * NODES, a - fi, b - fj, c - fk)
        slope = quantum * CELLS * per_mm
        d = d * quantum
        gx = gx * slope
        gy = gy * slope
        gz = gz * slope
    else:
        d, gx, gy, gz = _cell(coarse, (i * ny + j) * nz + k, nz, ny * nz, a, b, c)
        gx = gx * per_mm
        gy = gy * per_mm
        gz = gz * per_mm
    if cu != u or cv != v or cw != w:
        # Outside the grid: straight on from the surface point nearest to its border.
        gx = (u - cu) * step + d * gx
        gy = (v - cv) * step + d * gy
        gz = (w - cw) * step + d * gz
        d = math.sqrt(gx * gx + gy * gy + gz * gz)
        if d > 0.0:
            gx = gx / d
            gy = gy / d
            gz = gz / d
    return d, gx, gy, gz


@kernel()
def look_up_all(points, grid, out):
    """Distance and gradient, (n, 4), of points (n, 3); NaN where a point is not finite."""
    for n in range(points.shape[0]):
        x = points[n, 0]
        y = points[n, 1]
        z = points[n, 2]
        if math.isfinite(x) and math.isfinite(y) and math.isfinite(z):
            out[n, 0], out[n, 1], out[n, 2], out[n, 3] = look_up(x, y, z, grid)
        else:
            out[n, 0] = out[n, 1] = out[n, 2] = out[n, 3] = math.nan


@inner_kernel()
def _crossing(corners, m, p, q, axis):
    """(+1, -1 or 0 for a miss, where along `axis`) of the line at (p, q) of the two other axes
    through a triangle.
    """
    s = (axis + 1) % 3
    t = (axis + 2) % 3
    a_s = corners[m, 0, s] - p
    b_s = corners[m, 1, s] - p
    c_s = corners[m, 2, s] - p
    a_t = corners[m, 0, t] - q
    b_t = corners[m, 1, t] - q
    c_t = corners[m, 2, t] - q
    e0 = b_s * c_t - b_t * c_s
    e1 = c_s * a_t - c_t * a_s
    e2 = a_s * b_t - a_t * b_s
    total = e0 + e1 + e2
    if total == 0.0 or not ((e0 > 0 and e1 > 0 and e2 > 0) or (e0 < 0 and e1 < 0 and e2 < 0)):
        return 0, 0.0
    at = (e0 * corners[m, 0, axis] + e1 * corners[m, 1, axis] + e2 * corners[m, 2, axis]) / total
    return (1 if total > 0 else -1), at


@kernel()
def find_crossings(corners, axis, shape, shift, count, first, where, sign):
    """Find where each grid line along an axis crosses triangles (m, 3, 3), in grid units: into
    `count`, and after `first`.

    Without room in `where` crossings are only counted.
    """
    s = (axis + 1) % 3
    t = (axis + 2) % 3
    for m in range(corners.shape[0]):
        low_s = min(corners[m, 0, s], corners[m, 1, s], corners[m, 2, s]) - shift[s]
        high_s = max(corners[m, 0, s], corners[m, 1, s], corners[m, 2, s]) - shift[s]
        low_t = min(corners[m, 0, t], corners[m, 1, t], corners[m, 2, t]) - shift[t]
        high_t = max(corners[m, 0, t], corners[m, 1, t], corners[m, 2, t]) - shift[t]
        for i in range(max(0, math.ceil(low_s)), min(shape[s] - 1, math.floor(high_s)) + 1):
            for j in range(max(0, math.ceil(low_t)), min(shape[t] - 1, math.floor(high_t)) + 1):
                way, at = _crossing(corners, m, i + shift[s], j + shift[t], axis)
                if way != 0:
                    line = i * shape[t] + j
                    if where.size:
                        where[first[line] + count[line]] = at
                        sign[first[line] + count[line]] = way
                    count[line] += 1


@kernel()
def vote_inside(nodes, axis, shape, first, where, sign, by_parity, votes):
    """Add 1 to `votes` (n,) of each grid node (n, 3) that is inside by its line along `axis`."""
    s = (axis + 1) % 3
    t = (axis + 2) % 3
    for n in range(nodes.shape[0]):
        line = nodes[n, s] * shape[t] + nodes[n, t]
        winding = 0
        passed = 0
        for m in range(first[line], first[line + 1]):
            if where[m] < nodes[n, axis]:
                winding += sign[m]
                passed += 1
        votes[n] += (passed % 2 == 1) if by_parity else (winding != 0)
