# pyright: basic
"""Compiled loops that build a distance grid: candidate triangles per cell, exact distances near the
surface, sweeps beyond.

Everything runs on one thread: results are reproducible.
"""

from __future__ import annotations

import math

import numpy as np

from pipeline.core.cached_kernels import inner_kernel, kernel
from pipeline.core.geometry.distance_grid_kernels import CELLS, NODES

_SUB = 3  # nodes along the edge of a part of a block that shares a list of triangles
_PARTS = NODES // _SUB
_STEPS = 3  # from one foot point to the next

# A face is a row of 19: corner, two edges, their three products, unit normal, centre, radius from
# there.


@inner_kernel()
def _share(along, whole):
    """Position along an edge of a point's foot, clamped to the edge."""
    return min(max(along / whole, 0.0), 1.0) if whole > 0.0 else 0.0


@inner_kernel()
def _squared_distance(f, m, x, y, z):
    """Squared distance of a point to a face."""
    x = x - f[m, 0]
    y = y - f[m, 1]
    z = z - f[m, 2]
    d1 = f[m, 3] * x + f[m, 4] * y + f[m, 5] * z
    d2 = f[m, 6] * x + f[m, 7] * y + f[m, 8] * z
    v = f[m, 11] * d1 - f[m, 10] * d2
    w = f[m, 9] * d2 - f[m, 10] * d1
    if v >= 0.0 and w >= 0.0 and v + w <= f[m, 9] * f[m, 11] - f[m, 10] * f[m, 10]:
        away = f[m, 12] * x + f[m, 13] * y + f[m, 14] * z
        if f[m, 12] != 0.0 or f[m, 13] != 0.0 or f[m, 14] != 0.0:
            return away * away
    s = _share(d1, f[m, 9])
    ex = x - s * f[m, 3]
    ey = y - s * f[m, 4]
    ez = z - s * f[m, 5]
    best = ex * ex + ey * ey + ez * ez
    s = _share(d2, f[m, 11])
    ex = x - s * f[m, 6]
    ey = y - s * f[m, 7]
    ez = z - s * f[m, 8]
    best = min(best, ex * ex + ey * ey + ez * ez)
    s = _share(d2 - d1 - f[m, 10] + f[m, 9], f[m, 9] + f[m, 11] - 2.0 * f[m, 10])
    ex = x - f[m, 3] - s * (f[m, 6] - f[m, 3])
    ey = y - f[m, 4] - s * (f[m, 7] - f[m, 4])
    ez = z - f[m, 5] - s * (f[m, 8] - f[m, 5])
    return min(best, ex * ex + ey * ey + ez * ez)


@inner_kernel()
def _plane_distance(f, m, x, y, z):
    """Signed distance of a point to a face's plane."""
    return f[m, 12] * (x - f[m, 0]) + f[m, 13] * (y - f[m, 1]) + f[m, 14] * (z - f[m, 2])


@inner_kernel()
def _is_farther(f, m, x, y, z, distance):
    """Whether all of a face is farther from a point than `distance`, by its bounding sphere or
    its plane.
    """
    away = _plane_distance(f, m, x, y, z)
    x = x - f[m, 15]
    y = y - f[m, 16]
    z = z - f[m, 17]
    most = distance + f[m, 18]
    return x * x + y * y + z * z > most * most or abs(away) > distance


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


@inner_kernel()
def _near_part(all_faces, candidates, x, y, z, twice_radius, near, squares):
    """Collect into `near` the candidates that can be nearest to a node of a block's part around (x,
    y, z); returns their number.

    A face is left out when another is nearer to every node of the part.
    """
    faces_of, begin, end = candidates
    least = math.inf
    most = math.inf
    for c in range(begin, end):
        m = np.int64(faces_of[c])
        square = (
            math.inf
            if _is_farther(all_faces, m, x, y, z, most)
            else _squared_distance(all_faces, m, x, y, z)
        )
        squares[c - begin] = square
        if square < least:
            least = square
            most = math.sqrt(least) + twice_radius
    n = 0
    for c in range(begin, end):
        if squares[c - begin] <= most * most:
            near[n] = faces_of[c]
            n += 1
    return n


@kernel()
def measure_blocks(all_faces, chosen, first, faces_of, fine_step, start, room, measured, coarse):
    """Measure distances (blocks, 9, 9, 9) at the nodes of cells `chosen` (n, 3), and their faces,
    into `measured`.

    The blocks' lists of faces begin at number `start`; `room` holds twice the longest of them. The
    blocks' corners are copied to the nodes of `coarse`: face and squared distance.
    """
    (near, squares), (out, nearest), (coarse_nearest, coarse_square) = room, measured, coarse
    middle = (_SUB - 1) / 2.0
    twice_radius = math.sqrt(3.0) * (_SUB - 1) * fine_step * (1.0 + 1e-9)
    for n in range(chosen.shape[0]):
        candidates = (faces_of, first[start + n], first[start + n + 1])
        u = chosen[n, 0] * CELLS
        v = chosen[n, 1] * CELLS
        w = chosen[n, 2] * CELLS
        for part in range(_PARTS * _PARTS * _PARTS):
            i = _SUB * (part // (_PARTS * _PARTS))
            j = _SUB * (part // _PARTS % _PARTS)
            k = _SUB * (part % _PARTS)
            x = (u + i + middle) * fine_step
            y = (v + j + middle) * fine_step
            z = (w + k + middle) * fine_step
            n_near = _near_part(all_faces, candidates, x, y, z, twice_radius, near, squares)
            last = np.int64(near[0])  # the neighbour's nearest face is a good first guess
            for a in range(i, i + _SUB):
                for b in range(j, j + _SUB):
                    for c in range(k, k + _SUB):
                        x = (u + a) * fine_step
                        y = (v + b) * fine_step
                        z = (w + c) * fine_step
                        square, last = _nearest(all_faces, near, n_near, last, x, y, z)
                        out[n, a, b, c] = math.sqrt(square)
                        nearest[n, a, b, c] = last
        for corner in range(8):
            a = corner & 1
            b = (corner >> 1) & 1
            c = corner >> 2
            i = chosen[n, 0] + a
            j = chosen[n, 1] + b
            k = chosen[n, 2] + c
            found = out[n, a * CELLS, b * CELLS, c * CELLS]
            if found * found < coarse_square[i, j, k]:
                coarse_square[i, j, k] = found * found
                coarse_nearest[i, j, k] = nearest[n, a * CELLS, b * CELLS, c * CELLS]


@inner_kernel()
def _nearest(all_faces, near, n_near, last, x, y, z):
    """(squared distance, face) of the nearest of a list of faces; `last` is the first guess."""
    best = _squared_distance(all_faces, last, x, y, z)
    face = last
    reach = math.sqrt(best)
    for c in range(n_near):
        m = np.int64(near[c])
        if m == last or _is_farther(all_faces, m, x, y, z, reach):
            continue
        square = _squared_distance(all_faces, m, x, y, z)
        if square < best:
            best = square
            face = m
            reach = math.sqrt(square)
    return best, face


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
                    if p > 0:
                        _adopt_nearer_face(
                            all_faces,
                            step,
                            nearest,
                            square,
                            i,
                            j,
                            k,
                            np.int64(nearest[i - a, j, k]),
                        )
                    if q > 0:
                        _adopt_nearer_face(
                            all_faces,
                            step,
                            nearest,
                            square,
                            i,
                            j,
                            k,
                            np.int64(nearest[i, j - b, k]),
                        )
                    if r > 0:
                        _adopt_nearer_face(
                            all_faces,
                            step,
                            nearest,
                            square,
                            i,
                            j,
                            k,
                            np.int64(nearest[i, j, k - c]),
                        )


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
