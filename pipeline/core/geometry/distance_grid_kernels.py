# pyright: basic
"""Compiled loops of the distance grid: look-up of distances, and its build: candidate triangles per
cell, exact distances near the surface, sweeps beyond, inside or outside by grid lines.

Everything runs on one thread: results are reproducible.
"""

from __future__ import annotations

import math

import numpy as np

from pipeline.core.cached_kernels import inner_kernel, kernel

CELLS = 8  # fine cells along a block's edge
NODES = CELLS + 1
_STEPS = 3  # from one foot point to the next
# A face is a row of 19: corner, two edges, their three products, unit normal, centre, radius from
# there.


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


@inner_kernel()
def _share(along, whole):
    """Position along an edge of a point's foot, clamped to the edge."""
    return min(max(along / whole, 0.0), 1.0) if whole > 0.0 else 0.0


@inner_kernel()
def _foot(f, m, x, y, z):
    """The point of a face that is nearest to a point."""
    x = x - f[m, 0]
    y = y - f[m, 1]
    z = z - f[m, 2]
    d1 = f[m, 3] * x + f[m, 4] * y + f[m, 5] * z
    d2 = f[m, 6] * x + f[m, 7] * y + f[m, 8] * z
    v = f[m, 11] * d1 - f[m, 10] * d2
    w = f[m, 9] * d2 - f[m, 10] * d1
    whole = f[m, 9] * f[m, 11] - f[m, 10] * f[m, 10]
    if v >= 0.0 and w >= 0.0 and v + w <= whole and whole > 0.0:
        v = v / whole
        w = w / whole
    else:
        ab = _share(d1, f[m, 9])
        ac = _share(d2, f[m, 11])
        bc = _share(d2 - d1 - f[m, 10] + f[m, 9], f[m, 9] + f[m, 11] - 2.0 * f[m, 10])
        best = math.inf
        for edge in range(3):
            p = ab if edge == 0 else 0.0
            q = ac if edge == 1 else 0.0
            p = 1.0 - bc if edge == 2 else p
            q = bc if edge == 2 else q
            dx = x - p * f[m, 3] - q * f[m, 6]
            dy = y - p * f[m, 4] - q * f[m, 7]
            dz = z - p * f[m, 5] - q * f[m, 8]
            square = dx * dx + dy * dy + dz * dz
            if square < best:
                best = square
                v = p
                w = q
    return (
        f[m, 0] + v * f[m, 3] + w * f[m, 6],
        f[m, 1] + v * f[m, 4] + w * f[m, 7],
        f[m, 2] + v * f[m, 5] + w * f[m, 8],
    )


@inner_kernel()
def _squared_distance(f, m, x, y, z):
    """Squared distance of a point to a face."""
    a, b, c = _foot(f, m, x, y, z)
    return (x - a) * (x - a) + (y - b) * (y - b) + (z - c) * (z - c)


@inner_kernel()
def _plane_distance(f, m, x, y, z):
    """Signed distance of a point to a face's plane."""
    return f[m, 12] * (x - f[m, 0]) + f[m, 13] * (y - f[m, 1]) + f[m, 14] * (z - f[m, 2])


@inner_kernel()
def _is_farther(f, m, x, y, z, distance):
    """Whether all of a face is farther from a point than `distance`, by its bounding sphere or
    its plane.
    """
    dx = x - f[m, 15]
    dy = y - f[m, 16]
    dz = z - f[m, 17]
    most = distance + f[m, 18]
    if dx * dx + dy * dy + dz * dz > most * most:
        return True
    return abs(_plane_distance(f, m, x, y, z)) > distance


@inner_kernel()
def _range(a, b, c, reach, step, n):
    """(first, end) cells along an axis whose centre is within `reach` of corners at a, a + b and
    a + c.
    """
    low = (a + min(0.0, b, c) - reach) / step - 0.5
    high = (a + max(0.0, b, c) + reach) / step - 0.5
    return max(0, math.ceil(low)), min(n - 1, math.floor(high)) + 1


@kernel()
def visit_cells(all_faces, cells, step, reach, best, number, limit, count, first, faces_of):
    """Visit the faces within `reach` of each cell's centre, flat in C order, in one of three
    passes.

    Without any `limit`: the least squared distance, into `best`. Else for every cell with a
    `number` how many faces are within its limit, into `count`; and where `faces_of` has room, their
    indices after `first`.
    """
    f = all_faces
    for m in range(f.shape[0]):
        i0, i1 = _range(f[m, 0], f[m, 3], f[m, 6], reach, step, cells[0])
        j0, j1 = _range(f[m, 1], f[m, 4], f[m, 7], reach, step, cells[1])
        k0, k1 = _range(f[m, 2], f[m, 5], f[m, 8], reach, step, cells[2])
        for i in range(i0, i1):
            for j in range(j0, j1):
                for k in range(k0, k1):
                    at = (i * cells[1] + j) * cells[2] + k
                    x = (i + 0.5) * step
                    y = (j + 0.5) * step
                    z = (k + 0.5) * step
                    most = reach
                    if limit.size:
                        if number[at] < 0:
                            continue
                        most = limit[number[at]]
                    if abs(_plane_distance(f, m, x, y, z)) > most:
                        continue
                    square = _squared_distance(f, m, x, y, z)
                    if not limit.size:
                        best[at] = min(best[at], square)
                    elif square <= most * most:
                        if faces_of.size:
                            faces_of[first[number[at]] + count[number[at]]] = m
                        count[number[at]] += 1


@kernel()
def measure_blocks(all_faces, chosen, first, faces_of, fine_step, measured, coarse):
    """Measure distances (blocks, 9, 9, 9) at the nodes of cells `chosen` (n, 3), and their faces,
    into `measured`.

    The faces of block n are those of `faces_of` from number `first[n]` on. The blocks' corners are
    copied to the nodes of `coarse`: face and squared distance.
    """
    (out, nearest), (coarse_nearest, coarse_square) = measured, coarse
    for n in range(chosen.shape[0]):
        u = chosen[n, 0] * CELLS
        v = chosen[n, 1] * CELLS
        w = chosen[n, 2] * CELLS
        last = np.int64(faces_of[first[n]])  # the neighbour's nearest face is a good first guess
        for a in range(NODES):
            for b in range(NODES):
                for c in range(NODES):
                    x = (u + a) * fine_step
                    y = (v + b) * fine_step
                    z = (w + c) * fine_step
                    square = _squared_distance(all_faces, last, x, y, z)
                    reach = math.sqrt(square)
                    for k in range(first[n], first[n + 1]):
                        face = np.int64(faces_of[k])
                        if _is_farther(all_faces, face, x, y, z, reach):
                            continue
                        found = _squared_distance(all_faces, face, x, y, z)
                        if found < square:
                            square = found
                            reach = math.sqrt(square)
                            last = face
                    out[n, a, b, c] = reach
                    nearest[n, a, b, c] = last
                    if a % CELLS == 0 and b % CELLS == 0 and c % CELLS == 0:
                        i = chosen[n, 0] + a // CELLS
                        j = chosen[n, 1] + b // CELLS
                        k = chosen[n, 2] + c // CELLS
                        if square < coarse_square[i, j, k]:
                            coarse_square[i, j, k] = square
                            coarse_nearest[i, j, k] = last


@inner_kernel()
def _adopt_nearer_face(all_faces, step, nearest, square, i, j, k, face):
    """Take over a neighbour's face if it is nearer."""
    if face >= 0 and face != nearest[i, j, k]:
        found = _squared_distance(all_faces, face, i * step, j * step, k * step)
        if found < square[i, j, k]:
            square[i, j, k] = found
            nearest[i, j, k] = face


@kernel()
def sweep_nearest_faces(all_faces, step, nearest, square):
    """Propagate squared distances to all coarse nodes (in place), each to the best face of its
    neighbours.
    """
    nx, ny, nz = nearest.shape
    for turn in range(8):
        a = 1 - 2 * (turn & 1)
        b = 1 - (turn & 2)
        c = 1 - ((turn & 4) >> 1)
        for p in range(nx):
            i = p if a > 0 else nx - 1 - p
            for q in range(ny):
                j = q if b > 0 else ny - 1 - q
                for r in range(nz):
                    k = r if c > 0 else nz - 1 - r
                    for axis in range(3):
                        u = i - a if axis == 0 else i
                        v = j - b if axis == 1 else j
                        w = k - c if axis == 2 else k
                        if 0 <= u < nx and 0 <= v < ny and 0 <= w < nz:
                            face = np.int64(nearest[u, v, w])
                            _adopt_nearer_face(all_faces, step, nearest, square, i, j, k, face)


@inner_kernel()
def _cell_of(x, y, z, step, cells):
    i = min(int(x / step), cells[0] - 1)
    j = min(int(y / step), cells[1] - 1)
    k = min(int(z / step), cells[2] - 1)
    return (max(i, 0) * cells[1] + max(j, 0)) * cells[2] + max(k, 0)


@kernel()
def refine_nearest_faces(all_faces, step, cells, number, first, faces_of, nearest, square):
    """Exchange each coarse node's face for a nearer one around its foot point, until there is
    none.
    """
    nx, ny, nz = nearest.shape
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                x = i * step
                y = j * step
                z = k * step
                for _again in range(_STEPS):
                    a, b, c = _foot(all_faces, np.int64(nearest[i, j, k]), x, y, z)
                    cell = number[_cell_of(a, b, c, step, cells)]
                    before = nearest[i, j, k]
                    if cell >= 0:
                        for m in range(first[cell], first[cell + 1]):
                            face = np.int64(faces_of[m])
                            if not _is_farther(
                                all_faces, face, x, y, z, math.sqrt(square[i, j, k])
                            ):
                                _adopt_nearer_face(all_faces, step, nearest, square, i, j, k, face)
                    if nearest[i, j, k] == before:
                        break
