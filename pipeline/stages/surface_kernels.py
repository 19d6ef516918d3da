# pyright: basic
"""Compiled loops of the surface mode: the source grid drawn as triangles, row by row.

1/z is linear in screen space, and the largest wins: the point nearest to the camera. Most quads of a fine source lie
between the pixel centres of a coarse target; they are told apart for whole rows at once, on vectors, before any
triangle is made.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

SLACK = 1e-9  # barycentric and px: neighbours share the pixels on their common edge, so that no crack opens
JUMP, GRAZING, BEHIND, FLIPPED, KEPT = 0, 1, 2, 3, 4  # what becomes of a triangle; from FLIPPED on it is drawn
_BEHIND = 16  # in the state of a corner; 1 = in front of the lens, 0 = none


@njit(cache=True)
def is_sorted(source_index):
    """Whether the points come in the order of their source pixels, each of them once."""
    falls = 0
    for i in range(1, source_index.shape[0]):
        falls += source_index[i] <= source_index[i - 1]
    return falls == 0


@njit(cache=True, error_model="numpy")
def neighbour_distances(flat, source_index, order, stride, every, z_min, out):
    """Write the distances of every `every`-th pair of points that are neighbours in a row; returns how many."""
    n = 0
    for place in range(0, source_index.shape[0] - 1, every):
        i, j = (order[place], order[place + 1]) if order.shape[0] > 0 else (np.int64(place), np.int64(place + 1))
        if source_index[j] - source_index[i] != stride or not (flat[3 * i + 2] > z_min and flat[3 * j + 2] > z_min):
            continue
        d_sq = 0.0
        for axis in range(3):
            d = np.float64(flat[3 * i + axis]) - np.float64(flat[3 * j + axis])
            d_sq += d * d
        if d_sq < np.inf and n < out.shape[0]:
            out[n] = math.sqrt(d_sq)
            n += 1
    return n


@njit(cache=True, error_model="numpy")
def rasterise(flat, source_index, order, cols, stride, lens, shape, z_min, limits, inverse_z, source, alone, counts):
    """Draw the source grid of `cols` columns as triangles.

    `flat` (3 n) holds the points, `order` their sequence by source pixel, empty when they come so; neighbours are
    `stride` rows or columns apart. `limits` are the longest edge, mm, squared, and the smallest cosine between normal
    and line of sight. Writes inverse_z and source of the target image, flat; sets in `alone` the points that have no
    neighbours to form a triangle with, drawn or not; and counts, by fate, the triangles that cover a pixel centre.
    """
    n = (cols - 1) // stride + 1
    at = np.full(2 * n, -1, dtype=np.int32)  # two rows in turn: the point of each column,
    x, y, z = np.zeros(2 * n), np.zeros(2 * n), np.zeros(2 * n)  # where it is,
    u, v, w = np.zeros(2 * n), np.zeros(2 * n), np.zeros(2 * n)  # where it is seen, px, and its 1/z
    state, linked = np.zeros(2 * n, dtype=np.uint8), np.zeros(2 * n, dtype=np.uint8)
    across, down = np.zeros(2 * n, dtype=np.int32), np.zeros(2 * n, dtype=np.int32)  # between which pixel centres
    busy = np.zeros(n + 1, dtype=np.uint8)  # of the quad to the left of each column
    low, high, row = n, 0, -stride  # columns in use of the row before
    old, new = 0, n
    place = 0
    while place < source_index.shape[0]:
        old, new = new, old
        first = order[place] if order.shape[0] > 0 else np.int64(place)
        next_row = source_index[first] // cols
        at[new : new + n] = -1
        state[new : new + n] = 0
        linked[new : new + n] = 0
        start, end, place = _load(
            flat, source_index, order, place, next_row, cols, stride, at[new : new + n],
            x[new : new + n], y[new : new + n], z[new : new + n], alone,
        )  # fmt: skip
        a, b = new + start, new + end
        _see(x[a:b], y[a:b], z[a:b], at[a:b], lens, z_min, u[a:b], v[a:b], w[a:b], state[a:b])
        _between(u[a:b], across[a:b], shape[1])
        _between(v[a:b], down[a:b], shape[0])
        busy[:] = 0
        if next_row == row + stride:
            low, high = min(low, start), max(high, end)
            a, b, c, d = old + low, old + high, new + low, new + high
            _sort_out(state[a:b], across[a:b], down[a:b], state[c:d], across[c:d], down[c:d], busy[low + 1 : high])
            _draw_row(
                at, x, y, z, u, v, w, state, across, down, busy[low + 1 : high], a, c,
                limits, shape, inverse_z, source, counts,
            )  # fmt: skip
        a, b = old + low, old + high
        _link(busy[low : high + 1], at[a:b], state[a:b], linked[a:b], linked[new + low : new + high], alone)
        low, high, row = start, end, next_row
    busy[:] = 0
    _link(busy, at[new : new + n], state[new : new + n], linked[new : new + n], linked[old : old + n], alone)


@njit(cache=True)
def _load(flat, source_index, order, place, row, cols, stride, at, x, y, z, alone):
    """Spread the points of one source row over its columns; returns (first column, end, where the next row begins).

    What lies between the columns of a strided cloud, or shares its source pixel, stands alone.
    """
    begin = row * cols
    if stride == 1 and order.shape[0] == 0:
        return _load_in_turn(flat, source_index, place, begin, at, x, y, z)
    start, end = at.shape[0], 0
    while place < source_index.shape[0]:
        i = order[place] if order.shape[0] > 0 else np.int64(place)
        column = source_index[i] - begin
        if column >= cols:
            break
        place += 1
        if stride > 1:
            if column % stride != 0:
                alone[i] = True
                continue
            column //= stride
        if at[column] >= 0:
            alone[at[column]] = True
        at[column] = i
        x[column], y[column], z[column] = flat[3 * i], flat[3 * i + 1], flat[3 * i + 2]
        start, end = min(start, column), max(end, column + 1)
    return min(start, end), end, place


@njit(cache=True)
def _load_in_turn(flat, source_index, place, begin, at, x, y, z):
    start, end = source_index[place] - begin, 0
    after = place + np.searchsorted(source_index[place : place + at.shape[0]], begin + at.shape[0])
    mine, points = source_index[place:after], flat[3 * place : 3 * after]
    if after > place:
        end = mine[after - place - 1] - begin + 1
    if end - start == after - place:  # without a gap
        at, x, y, z = at[start:end], x[start:end], y[start:end], z[start:end]
        for k in range(at.shape[0]):
            at[k] = place + k
            x[k], y[k], z[k] = points[3 * k], points[3 * k + 1], points[3 * k + 2]
    else:
        for k in range(mine.shape[0]):
            c = mine[k] - begin
            at[c] = place + k
            x[c], y[c], z[c] = points[3 * k], points[3 * k + 1], points[3 * k + 2]
    return start, end, after


@njit(cache=True, error_model="numpy")
def _see(x, y, z, at, lens, z_min, u, v, w, state):
    """Screen coordinates of a row of corners; the image's middle, harmlessly, for those that have none."""
    fx, fy, cx, cy = lens
    for c in range(x.shape[0]):
        there = at[c] >= 0
        ok = there & (z[c] > z_min) & (z[c] < np.inf) & (abs(x[c]) < np.inf) & (abs(y[c]) < np.inf)
        near = 1.0 / (z[c] if ok else 1.0)
        w[c] = near
        u[c] = fx * (x[c] if ok else 0.0) * near + cx
        v[c] = fy * (y[c] if ok else 0.0) * near + cy
        state[c] = np.uint8(1 if ok else (_BEHIND if there else 0))


@njit(cache=True)
def _between(u, place, size):
    """The pixel centres that each coordinate lies between, as first not before + last not after.

    That sum is even on a centre, to the slack, and odd between two: half of it, rounded up and down, gives them back.
    Clamped as floats to between two centres outside the image.
    """
    high = size + 0.5
    for c in range(u.shape[0]):
        near = u[c] if u[c] > -1.5 else -1.5
        near = near if near < high else high
        place[c] = np.int32(np.ceil(near - SLACK)) + np.int32(np.floor(near + SLACK))


@njit(cache=True)
def _sort_out(state, across, down, state_1, across_1, down_1, busy):
    """What is to be done with each quad: 0 no quad, 1 no pixel centre near it, 2 draw, _BEHIND a corner behind.

    What an absent corner left behind may widen the box, which costs a look and no more.
    """
    for c in range(busy.shape[0]):
        total = state[c] + state[c + 1] + state_1[c] + state_1[c + 1]
        corners = (total & 15) + (total >> 4)
        left = min(across[c], across[c + 1], across_1[c], across_1[c + 1])
        right = max(across[c], across[c + 1], across_1[c], across_1[c + 1])
        top = min(down[c], down[c + 1], down_1[c], down_1[c + 1])
        bottom = max(down[c], down[c + 1], down_1[c], down_1[c + 1])
        drawn = 2 if ((left + 1) >> 1 <= right >> 1) & ((top + 1) >> 1 <= bottom >> 1) else 1
        busy[c] = np.uint8(0 if corners < 3 else (_BEHIND if total >= _BEHIND else drawn))


@njit(cache=True)
def _link(busy, at, state, linked, linked_1, alone):
    """Set in `alone` the points of a row that no quad above it, `linked`, or below it, `busy`, has as a corner."""
    for c in range(at.shape[0]):
        linked_1[c] = busy[c] | busy[c + 1]
    lonely = False
    for c in range(at.shape[0]):
        linked[c] |= linked_1[c]
        lonely |= (state[c] != 0) & (linked[c] == 0)
    if lonely:
        for c in range(at.shape[0]):
            if state[c] != 0 and linked[c] == 0:
                alone[at[c]] = True


@njit(cache=True, error_model="numpy")
def _draw_row(at, x, y, z, u, v, w, state, across, down, busy, above, below, limits, shape, inverse_z, source, counts):
    """Draw a row of quads: two triangles along the shorter diagonal, which follows a crease; one if a corner lacks."""
    for column in range(busy.shape[0]):
        if busy[column] < 2:
            continue
        if busy[column] == _BEHIND:
            counts[BEHIND] += 1
            continue
        a, b, d, e = above + column, above + column + 1, below + column, below + column + 1
        i, j, k, o = a, b, d, e
        if state[a] == 0:
            i, j, k, o = b, e, d, -1
        elif state[b] == 0:
            i, j, k, o = a, e, d, -1
        elif state[d] == 0:
            i, j, k, o = a, b, e, -1
        elif state[e] == 0:
            o = -1
        elif _distance_sq(x, y, z, a, e) < _distance_sq(x, y, z, b, d):
            i, j, k, o = b, e, a, d
        # The triangles are (i, j, k) and, beyond the edge j-k, (j, o, k).
        one, other = True, o >= 0
        if other:
            col = (min(across[a], across[b], across[d], across[e]) + 1) >> 1
            row = (min(down[a], down[b], down[d], down[e]) + 1) >> 1
            if (
                col == max(across[a], across[b], across[d], across[e]) >> 1
                and row == max(down[a], down[b], down[d], down[e]) >> 1
            ):
                # Most often there is one centre to ask for, and the diagonal says which triangle may have it.
                beyond = (u[k] - u[j]) * (row - v[j]) - (v[k] - v[j]) * (col - u[j])
                side = (u[k] - u[j]) * (v[i] - v[j]) - (v[k] - v[j]) * (u[i] - u[j])
                near = abs(beyond) <= 4.0 * SLACK * abs(side)
                one = near or beyond * side > 0.0
                other = near or not one
        for t in range(2):
            if t == 1:
                i, j = j, o
            if one if t == 0 else other:
                _draw(at, x, y, z, u, v, w, across, down, i, j, k, limits, shape, inverse_z, source, counts)


@njit(cache=True, inline="always")
def _distance_sq(x, y, z, i, j):
    dx, dy, dz = x[i] - x[j], y[i] - y[j], z[i] - z[j]
    return dx * dx + dy * dy + dz * dz


@njit(cache=True, inline="always")
def _fate(x, y, z, i, j, k, max_edge_sq, min_cos):
    """JUMP, GRAZING, FLIPPED or KEPT, by the edges and by the angle between normal and line of sight."""
    if not (
        _distance_sq(x, y, z, i, j) <= max_edge_sq
        and _distance_sq(x, y, z, j, k) <= max_edge_sq
        and _distance_sq(x, y, z, k, i) <= max_edge_sq
    ):
        return JUMP
    bx, by, bz = x[j] - x[i], y[j] - y[i], z[j] - z[i]
    cx, cy, cz = x[k] - x[i], y[k] - y[i], z[k] - z[i]
    nx, ny, nz = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
    mx, my, mz = x[i] + (bx + cx) / 3.0, y[i] + (by + cy) / 3.0, z[i] + (bz + cz) / 3.0
    along = nx * mx + ny * my + nz * mz
    limit_sq = min_cos * min_cos * (nx * nx + ny * ny + nz * nz) * (mx * mx + my * my + mz * mz)
    if not (along * along >= limit_sq and along != 0.0):
        return GRAZING
    return KEPT if along > 0.0 else FLIPPED


@njit(cache=True, error_model="numpy", inline="always")
def _draw(at, x, y, z, u, v, w, across, down, i, j, k, limits, shape, inverse_z, source, counts):
    """Draw one triangle; what it is worth is asked only once it covers a pixel centre."""
    xa, ya, xb, yb, xc, yc = u[i], v[i], u[j], v[j], u[k], v[k]
    area = (xb - xa) * (yc - ya) - (xc - xa) * (yb - ya)
    first = max((min(across[i], across[j], across[k]) + 1) >> 1, 0)
    last = min(max(across[i], across[j], across[k]) >> 1, shape[1] - 1)
    top = max((min(down[i], down[j], down[k]) + 1) >> 1, 0)
    bottom = min(max(down[i], down[j], down[k]) >> 1, shape[0] - 1)
    if area == 0.0 or first > last or top > bottom:
        return
    scale = 1.0 / area
    asked = False
    for r in range(top, bottom + 1):
        for c in range(first, last + 1):
            a = ((xb - c) * (yc - r) - (xc - c) * (yb - r)) * scale
            b = ((xc - c) * (ya - r) - (xa - c) * (yc - r)) * scale
            g = 1.0 - a - b
            if a < -SLACK or b < -SLACK or g < -SLACK:
                continue
            if not asked:
                fate = _fate(x, y, z, i, j, k, limits[0], limits[1])
                counts[fate] += 1
                if fate < FLIPPED:
                    return
                asked = True
            near = a * w[i] + b * w[j] + g * w[k]
            p = r * shape[1] + c
            if near > inverse_z[p]:
                inverse_z[p] = near
                # The corner with the largest weight is the nearest one on screen.
                source[p] = at[i] if a >= b and a >= g else (at[j] if b >= g else at[k])
