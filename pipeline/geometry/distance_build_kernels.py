# pyright: basic
"""Compiled loops that measure a mesh: which triangles a cell can see, exact distances near the surface, swept beyond.

Everything runs on one thread: the same bytes on every machine.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from pipeline.geometry.distance_grid_kernels import CELLS, NODES

_SUB = 3  # nodes along the edge of a part of a block that shares a list of triangles
_STEPS = 3  # from one foot to the next
N_FACE = 19  # corner, two edges, their three products, unit normal, middle, how far it reaches from there


@njit(cache=True)
def faces(corners):
    """(m, 19) of triangles (m, 3, 3): what their distances are worked out from."""
    out = np.zeros((corners.shape[0], N_FACE))
    for m in range(corners.shape[0]):
        f = out[m]
        for k in range(3):
            f[k] = corners[m, 0, k]
            f[3 + k], f[6 + k] = corners[m, 1, k] - f[k], corners[m, 2, k] - f[k]
        f[9] = f[3] * f[3] + f[4] * f[4] + f[5] * f[5]
        f[10] = f[3] * f[6] + f[4] * f[7] + f[5] * f[8]
        f[11] = f[6] * f[6] + f[7] * f[7] + f[8] * f[8]
        nx, ny, nz = f[4] * f[8] - f[5] * f[7], f[5] * f[6] - f[3] * f[8], f[3] * f[7] - f[4] * f[6]
        square = nx * nx + ny * ny + nz * nz
        if square > 0.0:
            length = math.sqrt(square)
            f[12], f[13], f[14] = nx / length, ny / length, nz / length
        for k in range(3):
            f[15 + k] = f[k] + (f[3 + k] + f[6 + k]) / 3.0
        for corner in range(3):
            square = 0.0
            for k in range(3):
                square += (corners[m, corner, k] - f[15 + k]) ** 2
            f[18] = max(f[18], math.sqrt(square))
    return out


@njit(cache=True)
def _share(along, whole):
    """Where along an edge a point's foot lies, within the edge."""
    return min(max(along / whole, 0.0), 1.0) if whole > 0.0 else 0.0


@njit(cache=True)
def _square(f, m, x, y, z):
    """Squared distance of a point to a face."""
    x, y, z = x - f[m, 0], y - f[m, 1], z - f[m, 2]
    d1, d2 = f[m, 3] * x + f[m, 4] * y + f[m, 5] * z, f[m, 6] * x + f[m, 7] * y + f[m, 8] * z
    v, w = f[m, 11] * d1 - f[m, 10] * d2, f[m, 9] * d2 - f[m, 10] * d1
    if v >= 0.0 and w >= 0.0 and v + w <= f[m, 9] * f[m, 11] - f[m, 10] * f[m, 10]:
        away = f[m, 12] * x + f[m, 13] * y + f[m, 14] * z
        if f[m, 12] != 0.0 or f[m, 13] != 0.0 or f[m, 14] != 0.0:
            return away * away
    s = _share(d1, f[m, 9])
    ex, ey, ez = x - s * f[m, 3], y - s * f[m, 4], z - s * f[m, 5]
    best = ex * ex + ey * ey + ez * ez
    s = _share(d2, f[m, 11])
    ex, ey, ez = x - s * f[m, 6], y - s * f[m, 7], z - s * f[m, 8]
    best = min(best, ex * ex + ey * ey + ez * ez)
    s = _share(d2 - d1 - f[m, 10] + f[m, 9], f[m, 9] + f[m, 11] - 2.0 * f[m, 10])
    ex, ey, ez = (
        x - f[m, 3] - s * (f[m, 6] - f[m, 3]),
        y - f[m, 4] - s * (f[m, 7] - f[m, 4]),
        z - f[m, 5] - s * (f[m, 8] - f[m, 5]),
    )
    return min(best, ex * ex + ey * ey + ez * ez)


@njit(cache=True)
def _beyond(f, m, x, y, z, distance):
    """Whether all of a face is certainly farther from a point than `distance`: of its ball's middle, or its plane."""
    away = f[m, 12] * (x - f[m, 0]) + f[m, 13] * (y - f[m, 1]) + f[m, 14] * (z - f[m, 2])
    x, y, z, most = x - f[m, 15], y - f[m, 16], z - f[m, 17], distance + f[m, 18]
    return x * x + y * y + z * z > most * most or abs(away) > distance


@njit(cache=True)
def _range(f, m, axis, reach, step, n):
    """(first, last) cell along an axis whose middle is within `reach` of a face's extent."""
    a, b, c = f[m, axis], f[m, axis] + f[m, 3 + axis], f[m, axis] + f[m, 6 + axis]
    low, high = (min(a, b, c) - reach) / step - 0.5, (max(a, b, c) + reach) / step - 0.5
    return max(0, math.ceil(low)), min(n - 1, math.floor(high))


@njit(cache=True)
def _seen(f, m, i, j, k, step, most):
    """Squared distance of a cell's middle to a face, or infinity where the face's plane is farther than `most`."""
    x, y, z = (i + 0.5) * step, (j + 0.5) * step, (k + 0.5) * step
    away = f[m, 12] * (x - f[m, 0]) + f[m, 13] * (y - f[m, 1]) + f[m, 14] * (z - f[m, 2])
    return math.inf if abs(away) > most else _square(f, m, x, y, z)


@njit(cache=True)
def nearest_of_cells(all_faces, cells, step, reach):
    """Distance of each cell's middle (flat, C order) to the surface, infinity beyond `reach`."""
    nx, ny, nz = cells
    best = np.full(nx * ny * nz, math.inf)
    for m in range(all_faces.shape[0]):
        i0, i1 = _range(all_faces, m, 0, reach, step, nx)
        j0, j1 = _range(all_faces, m, 1, reach, step, ny)
        k0, k1 = _range(all_faces, m, 2, reach, step, nz)
        for i in range(i0, i1 + 1):
            for j in range(j0, j1 + 1):
                for k in range(k0, k1 + 1):
                    at = (i * ny + j) * nz + k
                    best[at] = min(best[at], _seen(all_faces, m, i, j, k, step, reach))
    for at in range(best.size):
        best[at] = math.sqrt(best[at]) if best[at] <= reach * reach else math.inf
    return best


@njit(cache=True)
def _lists(all_faces, cells, step, number, limit, most, first, faces_of, filling):
    """Count (or fill in, after `first`) the faces within each numbered cell's `limit` of its middle."""
    nx, ny, nz = cells
    count = np.zeros(limit.size, np.int64)
    for m in range(all_faces.shape[0]):
        i0, i1 = _range(all_faces, m, 0, most, step, nx)
        j0, j1 = _range(all_faces, m, 1, most, step, ny)
        k0, k1 = _range(all_faces, m, 2, most, step, nz)
        for i in range(i0, i1 + 1):
            for j in range(j0, j1 + 1):
                for k in range(k0, k1 + 1):
                    cell = number[(i * ny + j) * nz + k]
                    if cell < 0 or _seen(all_faces, m, i, j, k, step, limit[cell]) > limit[cell] * limit[cell]:
                        continue
                    if filling:
                        faces_of[first[cell] + count[cell]] = m
                    count[cell] += 1
    return count


@njit(cache=True)
def lists_of_cells(all_faces, cells, step, number, limit):
    """(first (n + 1,), faces): of every cell with a `number`, the faces within its `limit` of its middle."""
    most = limit.max() if limit.size else 0.0
    nothing, none = np.empty(0, np.int32), np.empty(0, np.int64)
    count = _lists(all_faces, cells, step, number, limit, most, none, nothing, False)
    first = np.zeros(count.size + 1, np.int64)
    for n in range(count.size):
        first[n + 1] = first[n] + count[n]
    faces_of = np.empty(first[-1], np.int32)
    _lists(all_faces, cells, step, number, limit, most, first, faces_of, True)
    return first, faces_of


@njit(cache=True)
def _near_part(all_faces, candidates, x, y, z, twice_radius, near, squares):
    """Those candidates that can be nearest to a node of a part of a block around (x, y, z): into `near`, their number.

    A face is left out when another is nearer to every node of the part.
    """
    least, most = math.inf, math.inf
    for c in range(candidates.size):
        m = candidates[c]
        squares[c] = math.inf if _beyond(all_faces, m, x, y, z, most) else _square(all_faces, m, x, y, z)
        if squares[c] < least:
            least = squares[c]
            most = math.sqrt(least) + twice_radius
    limit, n = most * most, 0
    for c in range(candidates.size):
        if squares[c] <= limit:
            near[n] = candidates[c]
            n += 1
    return n


@njit(cache=True)
def measure_blocks(all_faces, chosen, first, faces_of, fine_step, start, out, nearest):
    """Distances (blocks, 9, 9, 9) of the nodes of cells `chosen` (n, 3), and the faces that they are to.

    The blocks' lists of faces begin at number `start`.
    """
    longest = 1
    for n in range(chosen.shape[0]):
        longest = max(longest, first[start + n + 1] - first[start + n])
    near, squares = np.empty(longest, np.int32), np.empty(longest)
    middle, twice_radius = (_SUB - 1) / 2.0, math.sqrt(3.0) * (_SUB - 1) * fine_step * (1.0 + 1e-9)
    for n in range(chosen.shape[0]):
        candidates = faces_of[first[start + n] : first[start + n + 1]]
        u, v, w = chosen[n, 0] * CELLS, chosen[n, 1] * CELLS, chosen[n, 2] * CELLS
        for i in range(0, NODES, _SUB):
            for j in range(0, NODES, _SUB):
                for k in range(0, NODES, _SUB):
                    x, y, z = (u + i + middle) * fine_step, (v + j + middle) * fine_step, (w + k + middle) * fine_step
                    m = _near_part(all_faces, candidates, x, y, z, twice_radius, near, squares)
                    _measure_part(all_faces, near[:m], u, v, w, i, j, k, fine_step, out[n], nearest[n])


@njit(cache=True)
def _measure_part(all_faces, near, u, v, w, i0, j0, k0, fine_step, out, nearest):
    last = near[0]  # what was nearest to the neighbour is a good first guess
    for i in range(i0, i0 + _SUB):
        for j in range(j0, j0 + _SUB):
            for k in range(k0, k0 + _SUB):
                x, y, z = (u + i) * fine_step, (v + j) * fine_step, (w + k) * fine_step
                best, face = _square(all_faces, last, x, y, z), last
                reach = math.sqrt(best)
                for c in range(near.size):
                    m = near[c]
                    if m == last or _beyond(all_faces, m, x, y, z, reach):
                        continue
                    square = _square(all_faces, m, x, y, z)
                    if square < best:
                        best, face, reach = square, m, math.sqrt(square)
                out[i, j, k], nearest[i, j, k] = reach, face
                last = face


@njit(cache=True)
def _better(all_faces, step, nearest, square, i, j, k, face):
    """Take over a neighbour's face if it is nearer."""
    if face >= 0 and face != nearest[i, j, k]:
        found = _square(all_faces, face, i * step, j * step, k * step)
        if found < square[i, j, k]:
            square[i, j, k], nearest[i, j, k] = found, face


@njit(cache=True)
def sweep(all_faces, step, nearest, square):
    """Squared distances of all coarse nodes (in place), each to the best of the faces that its neighbours know."""
    nx, ny, nz = nearest.shape
    for turn in range(8):
        a, b, c = 1 - 2 * (turn & 1), 1 - (turn & 2), 1 - ((turn & 4) >> 1)
        for p in range(nx):
            i = p if a > 0 else nx - 1 - p
            for q in range(ny):
                j = q if b > 0 else ny - 1 - q
                for r in range(nz):
                    k = r if c > 0 else nz - 1 - r
                    if p > 0:
                        _better(all_faces, step, nearest, square, i, j, k, nearest[i - a, j, k])
                    if q > 0:
                        _better(all_faces, step, nearest, square, i, j, k, nearest[i, j - b, k])
                    if r > 0:
                        _better(all_faces, step, nearest, square, i, j, k, nearest[i, j, k - c])


@njit(cache=True)
def _foot(f, m, x, y, z):
    """The point of a face that is nearest to a point."""
    x, y, z = x - f[m, 0], y - f[m, 1], z - f[m, 2]
    d1, d2 = f[m, 3] * x + f[m, 4] * y + f[m, 5] * z, f[m, 6] * x + f[m, 7] * y + f[m, 8] * z
    v, w, whole = f[m, 11] * d1 - f[m, 10] * d2, f[m, 9] * d2 - f[m, 10] * d1, f[m, 9] * f[m, 11] - f[m, 10] * f[m, 10]
    if v >= 0.0 and w >= 0.0 and v + w <= whole and whole > 0.0:
        v, w = v / whole, w / whole
    else:
        ab, ac = _share(d1, f[m, 9]), _share(d2, f[m, 11])
        bc = _share(d2 - d1 - f[m, 10] + f[m, 9], f[m, 9] + f[m, 11] - 2.0 * f[m, 10])
        v, w, best = ab, 0.0, math.inf
        for p, q in ((ab, 0.0), (0.0, ac), (1.0 - bc, bc)):
            square = 0.0
            for k in range(3):
                square += ((x, y, z)[k] - p * f[m, 3 + k] - q * f[m, 6 + k]) ** 2
            if square < best:
                best, v, w = square, p, q
    return f[m, 0] + v * f[m, 3] + w * f[m, 6], f[m, 1] + v * f[m, 4] + w * f[m, 7], f[m, 2] + v * f[m, 5] + w * f[m, 8]


@njit(cache=True)
def _cell_of(x, y, z, step, cells):
    i, j, k = (min(int(x / step), cells[0] - 1), min(int(y / step), cells[1] - 1), min(int(z / step), cells[2] - 1))
    return (max(i, 0) * cells[1] + max(j, 0)) * cells[2] + max(k, 0)


@njit(cache=True)
def settle(all_faces, step, cells, number, first, faces_of, nearest, square):
    """Each coarse node's face exchanged for a nearer one around its foot, if there is one, until there is none."""
    nx, ny, nz = nearest.shape
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                x, y, z = i * step, j * step, k * step
                for _again in range(_STEPS):
                    a, b, c = _foot(all_faces, nearest[i, j, k], x, y, z)
                    cell = number[_cell_of(a, b, c, step, cells)]
                    before = nearest[i, j, k]
                    if cell >= 0:
                        for m in range(first[cell], first[cell + 1]):
                            if not _beyond(all_faces, faces_of[m], x, y, z, math.sqrt(square[i, j, k])):
                                _better(all_faces, step, nearest, square, i, j, k, faces_of[m])
                    if nearest[i, j, k] == before:
                        break


@njit(cache=True)
def seed(chosen, distance, faces_of_nodes, nearest, square):
    """Hand the corners of measured blocks over to the coarse nodes."""
    for n in range(chosen.shape[0]):
        for corner in range(8):
            a, b, c = corner & 1, (corner >> 1) & 1, corner >> 2
            i, j, k = chosen[n, 0] + a, chosen[n, 1] + b, chosen[n, 2] + c
            found = distance[n, a * CELLS, b * CELLS, c * CELLS]
            if found * found < square[i, j, k]:
                square[i, j, k] = found * found
                nearest[i, j, k] = faces_of_nodes[n, a * CELLS, b * CELLS, c * CELLS]


@njit(cache=True)
def behind(all_faces, points, nearest):
    """Whether each point (n, 3) lies on the inner side of the face (n,) that is nearest to it."""
    out = np.zeros(nearest.size, np.bool_)
    for n in range(nearest.size):
        m = nearest[n]
        away = 0.0
        for k in range(3):
            away += all_faces[m, 12 + k] * (points[n, k] - all_faces[m, k])
        out[n] = away < 0.0
    return out
