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
_THERE, _UNSEEN = 1, 2  # bits of a corner: a point, and one behind the lens or not finite
_BEHIND = 16  # of a quad with such a corner
_BLOCK = 64  # columns; what the widest of today's processors takes at once, four times


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
    # Rows are worked on in whole blocks: the compiler's loops take their last few columns one by one otherwise.
    n = ((cols - 1) // stride // _BLOCK + 2) * _BLOCK
    at = np.full(2 * n, -1, dtype=np.int32)  # two rows in turn: the point of each column,
    u, v, w = np.zeros(2 * n), np.zeros(2 * n), np.zeros(2 * n)  # where that is seen, px, and its 1/z
    state, linked = np.zeros(2 * n, dtype=np.uint8), np.zeros(2 * n, dtype=np.uint8)
    across, down = np.zeros(2 * n, dtype=np.int32), np.zeros(2 * n, dtype=np.int32)  # between which pixel centres
    busy = np.zeros(n + 1, dtype=np.uint8)  # of the quad to the left of each column
    spread = np.zeros(3 * n, dtype=np.float32)  # a row with gaps
    low, high, row = 0, 0, -2 * stride  # columns in use of the row before
    old, new = 0, n
    place = 0
    while place < source_index.shape[0]:
        old, new = new, old
        here = order[place] if order.shape[0] > 0 else np.int64(place)
        next_row = source_index[here] // cols
        at[new : new + n] = -1
        state[new : new + n] = 0
        linked[new : new + n] = 0
        here = place
        start, end, place = _find(source_index, order, place, next_row, cols, stride, at[new : new + n], alone)
        a, b = new + start, new + end
        if order.shape[0] == 0 and end - start == place - here:
            strip = flat[3 * here : 3 * place]
            _see(strip, at[a:b], lens, z_min, u[a:b], v[a:b], w[a:b], state[a:b])
        else:
            _gather(flat, at[a:b], spread)
            _see(spread, at[a:b], lens, z_min, u[a:b], v[a:b], w[a:b], state[a:b])
        start, end = start // _BLOCK * _BLOCK, (end + _BLOCK - 1) // _BLOCK * _BLOCK
        _between(u[new + start : new + end], across[new + start : new + end], shape[1])
        _between(v[new + start : new + end], down[new + start : new + end], shape[0])
        busy[:] = 0
        if next_row == row + stride:
            low, high = min(low, start), max(high, end)
            a, b, c, d = old + low, old + high + 1, new + low, new + high + 1
            quads = busy[low + 1 : high + 1]
            _sort_out(state[a:b], across[a:b], down[a:b], state[c:d], across[c:d], down[c:d], quads)
            _draw_row(flat, at, u, v, w, state, across, down, quads, a, c, limits, shape, inverse_z, source, counts)
        a, b = old + low, old + high
        _link(busy[low : high + 1], at[a:b], state[a:b], linked[a:b], linked[new + low : new + high], alone)
        low, high, row = start, end, next_row
    busy[:] = 0
    _link(busy, at[new : new + n], state[new : new + n], linked[new : new + n], linked[old : old + n], alone)


@njit(cache=True)
def _find(source_index, order, place, row, cols, stride, at, alone):
    """Write the points of one source row into their columns; returns (first column, end, where the next row begins).

    What lies between the columns of a strided cloud, or shares its source pixel, stands alone.
    """
    begin = row * cols
    if stride == 1 and order.shape[0] == 0:
        after = place + np.searchsorted(source_index[place : place + cols], begin + cols)
        columns = source_index[place:after]
        for k in range(columns.shape[0]):
            at[columns[k] - begin] = place + k
        return columns[0] - begin, columns[columns.shape[0] - 1] - begin + 1, after
    start, end = at.shape[0], 0
    while place < source_index.shape[0]:
        i = order[place] if order.shape[0] > 0 else np.int64(place)
        column = source_index[i] - begin
        if column >= cols:
            break
        place += 1
        if column % stride != 0:
            alone[i] = True
            continue
        column //= stride
        if at[column] >= 0:
            alone[at[column]] = True
        at[column] = i
        start, end = min(start, column), max(end, column + 1)
    return min(start, end), end, place


@njit(cache=True)
def _gather(flat, at, spread):
    for c in range(at.shape[0]):
        i = 3 * max(at[c], 0)
        spread[3 * c], spread[3 * c + 1], spread[3 * c + 2] = flat[i], flat[i + 1], flat[i + 2]


@njit(cache=True, error_model="numpy")
def _see(strip, at, lens, z_min, u, v, w, state):
    """Screen coordinates of a row of corners; the image's middle, harmlessly, for those that have none."""
    fx, fy, cx, cy = lens
    for c in range(at.shape[0]):
        x, y, z = np.float64(strip[3 * c]), np.float64(strip[3 * c + 1]), np.float64(strip[3 * c + 2])
        there = at[c] >= 0
        ok = there & (z > z_min) & (z < np.inf) & (abs(x) < np.inf) & (abs(y) < np.inf)
        near = 1.0 / (z if ok else 1.0)
        w[c] = near
        u[c] = fx * (x if ok else 0.0) * near + cx
        v[c] = fy * (y if ok else 0.0) * near + cy
        state[c] = np.uint8(_THERE if ok else (_THERE | _UNSEEN if there else 0))


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

    Corners have bits _THERE and _UNSEEN in `state`. A box holds no centre if all four lie between the same two, in x
    or in y; what an absent corner left behind may widen it, which costs a look and no more. All of it in bits, which
    needs no wider numbers.
    """
    for c in range(busy.shape[0]):
        i, j, k, m = state[c], state[c + 1], state_1[c], state_1[c + 1]
        three = (i & j & (k | m)) | (k & m & (i | j))
        a, b = across[c], down[c]
        x = (a ^ across[c + 1]) | (a ^ across_1[c]) | (a ^ across_1[c + 1]) | (~a & 1)
        y = (b ^ down[c + 1]) | (b ^ down_1[c]) | (b ^ down_1[c + 1]) | (~b & 1)
        box = 2 if (x != 0) & (y != 0) else 1
        busy[c] = np.uint8(0 if three & _THERE == 0 else (_BEHIND if (i | j | k | m) & _UNSEEN != 0 else box))


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
def _draw_row(flat, at, u, v, w, state, across, down, busy, above, below, limits, shape, inverse_z, source, counts):
    """Draw a row of quads: two triangles along the shorter diagonal, which follows a crease; one if a corner lacks."""
    for column in range(busy.shape[0]):
        if busy[column] < 2:
            continue
        if busy[column] == _BEHIND:
            counts[BEHIND] += 1
            continue
        a, b, d, e = above + column, above + column + 1, below + column, below + column + 1
        # The triangles are (i, j, k) and, beyond the edge j-k, (j, o, k). Written as choices of numbers, since a
        # branch that goes either way costs more than what it saves.
        crossed = _distance_sq(flat, at[a], at[e]) < _distance_sq(flat, at[b], at[d])
        i, j, k, o = (b if crossed else a), (e if crossed else b), (a if crossed else d), (d if crossed else e)
        triangles = 2
        if state[a] == 0:
            i, j, k, triangles = b, e, d, 1
        elif state[b] == 0:
            i, j, k, triangles = a, e, d, 1
        elif state[d] == 0:
            i, j, k, triangles = a, b, e, 1
        elif state[e] == 0:
            i, j, k, triangles = a, b, d, 1
        else:
            col = (min(across[a], across[b], across[d], across[e]) + 1) >> 1
            row = (min(down[a], down[b], down[d], down[e]) + 1) >> 1
            if (
                col == max(across[a], across[b], across[d], across[e]) >> 1
                and row == max(down[a], down[b], down[d], down[e]) >> 1
            ):
                # Most often there is one centre to ask for, and the diagonal says which triangle may have it.
                beyond = (u[k] - u[j]) * (row - v[j]) - (v[k] - v[j]) * (col - u[j])
                side = (u[k] - u[j]) * (v[i] - v[j]) - (v[k] - v[j]) * (u[i] - u[j])
                if abs(beyond) > 4.0 * SLACK * abs(side):
                    first = beyond * side > 0.0
                    i, j = (i if first else j), (j if first else o)
                    triangles = 1
        for t in range(triangles):
            if t == 1:
                i, j = j, o
            _draw(flat, at, u, v, w, across, down, i, j, k, limits, shape, inverse_z, source, counts)


@njit(cache=True, inline="always")
def _distance_sq(flat, i, j):
    dx = np.float64(flat[3 * i]) - np.float64(flat[3 * j])
    dy = np.float64(flat[3 * i + 1]) - np.float64(flat[3 * j + 1])
    dz = np.float64(flat[3 * i + 2]) - np.float64(flat[3 * j + 2])
    return dx * dx + dy * dy + dz * dz


@njit(cache=True, inline="always")
def _fate(flat, i, j, k, max_edge_sq, min_cos):
    """JUMP, GRAZING, FLIPPED or KEPT, by the edges and by the angle between normal and line of sight."""
    x, y, z = np.float64(flat[3 * i]), np.float64(flat[3 * i + 1]), np.float64(flat[3 * i + 2])
    bx, by, bz = flat[3 * j] - x, flat[3 * j + 1] - y, flat[3 * j + 2] - z
    cx, cy, cz = flat[3 * k] - x, flat[3 * k + 1] - y, flat[3 * k + 2] - z
    dx, dy, dz = cx - bx, cy - by, cz - bz
    if not (
        bx * bx + by * by + bz * bz <= max_edge_sq
        and cx * cx + cy * cy + cz * cz <= max_edge_sq
        and dx * dx + dy * dy + dz * dz <= max_edge_sq
    ):
        return JUMP
    nx, ny, nz = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
    mx, my, mz = x + (bx + cx) / 3.0, y + (by + cy) / 3.0, z + (bz + cz) / 3.0
    along = nx * mx + ny * my + nz * mz
    limit_sq = min_cos * min_cos * (nx * nx + ny * ny + nz * nz) * (mx * mx + my * my + mz * mz)
    if not (along * along >= limit_sq and along != 0.0):
        return GRAZING
    return KEPT if along > 0.0 else FLIPPED


@njit(cache=True, error_model="numpy", inline="always")
def _draw(flat, at, u, v, w, across, down, i, j, k, limits, shape, inverse_z, source, counts):
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
                fate = _fate(flat, at[i], at[j], at[k], limits[0], limits[1])
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
