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

from pipeline.stages.project.rim_kernels import draw_rim, rim_room
from pipeline.stages.project.triangle_kernels import BEHIND_LENS, BORROWED, THERE, UNSEEN, between, draw_quads

_BLOCK = 64  # columns; what the widest of today's processors takes at once, four times
_MARGIN = 2  # columns left of the first: a rim looks at the quad outside it, and at that one's neighbour


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
    """Draw the source grid of `cols` columns as triangles, and its rim half a pixel beyond the outermost points.

    `flat` (3 n) holds the points, `order` their sequence by source pixel, empty when they come so; neighbours are
    `stride` rows or columns apart. `limits` are the longest edge, mm, squared, and the smallest cosine between normal
    and line of sight. Writes inverse_z and source of the target image, flat; sets in `alone` the points that have no
    neighbours to form a triangle with, drawn or not; and counts, by fate, the triangles that cover a pixel centre.
    """
    # Rows are worked on in whole blocks: the compiler's loops take their last few columns one by one otherwise.
    n = (((cols - 1) // stride + 2 * _MARGIN) // _BLOCK + 2) * _BLOCK
    at = np.full(4 * n, -1, dtype=np.int32)  # four rows in turn: the point of each column,
    u, v, w = np.zeros(4 * n), np.zeros(4 * n), np.zeros(4 * n)  # where that is seen, px, and its 1/z
    state, linked = np.zeros(4 * n, dtype=np.uint8), np.zeros(4 * n, dtype=np.uint8)
    across, down = np.zeros(4 * n, dtype=np.int32), np.zeros(4 * n, dtype=np.int32)  # between which pixel centres
    low, high = np.full(4, n, dtype=np.int64), np.zeros(4, dtype=np.int64)  # columns in use, of each of the four
    busy, rim = np.zeros(n + 1, dtype=np.uint8), np.zeros(n, dtype=np.uint8)  # of the quad to the left of each column
    todo, late = np.empty(n + 1, dtype=np.int32), np.empty(n + 1, dtype=np.int32)
    spread = np.zeros(3 * n, dtype=np.float32)  # a row with gaps
    _walk(flat, source_index, order, cols, stride, lens, shape, z_min, limits, inverse_z, source, alone, counts,
          n, at, u, v, w, state, linked, across, down, low, high, busy, rim, todo, late, spread,
          rim_room())  # fmt: skip


@njit(**BORROWED)
def _walk(flat, source_index, order, cols, stride, lens, shape, z_min, limits, inverse_z, source, alone, counts,
          n, at, u, v, w, state, linked, across, down, low, high, busy, rim, todo, late, spread, room):  # fmt: skip
    """The rows of `rasterise` from the first to the last, in the room that it made."""
    n_late = 0
    place, n_points, row = 0, source_index.shape[0], 0
    last_row = -1
    while place < n_points or row <= last_row + 2:
        next_row = -1
        if place < n_points:
            next_row = source_index[order[place] if order.shape[0] > 0 else np.int64(place)] // cols
            if next_row % stride != 0:
                place = _skip(source_index, order, place, (next_row + 1) * cols, alone)
                continue
            row = max(row, next_row // stride) if last_row < 0 else row
        one, two, three, new = (row + 1) & 3, (row + 2) & 3, (row + 3) & 3, row & 3
        a, b = new * n + low[new], new * n + high[new]
        if a < b:
            at[a:b], state[a:b] = -1, 0
        linked[new * n : new * n + n] = 0
        low[new], high[new] = n, 0
        if next_row == row * stride and place < n_points:
            last_row, here, left = row, place, new * n + _MARGIN
            start, end, place = _find(
                source_index, order, place, next_row, cols, stride, at[left : left + n - _MARGIN], alone
            )
            if start < end:
                a, b = left + start, left + end
                if order.shape[0] == 0 and end - start == place - here:
                    strip = flat[3 * here : 3 * place]
                    _see(strip, at[a:b], lens, z_min, u[a:b], v[a:b], w[a:b], state[a:b])
                else:
                    _gather(flat, at[a:b], spread)
                    _see(spread, at[a:b], lens, z_min, u[a:b], v[a:b], w[a:b], state[a:b])
                start = (start + _MARGIN - 1) // _BLOCK * _BLOCK
                end = (end + _MARGIN + _BLOCK - 1) // _BLOCK * _BLOCK
                a, b = new * n + start, new * n + end
                between(u[a:b], across[a:b], shape[1])
                between(v[a:b], down[a:b], shape[0])
                low[new], high[new] = start, end
        if n_late > 0:
            draw_rim(flat, at, u, v, w, state, late[:n_late], (one * n, two * n, three * n, new * n), lens, z_min,
                     limits, shape, inverse_z, source, room)  # fmt: skip
            n_late = 0
        start, end = min(low[three], low[new]), max(high[three], high[new])
        if start < end:
            a, b, c, d = three * n + start, three * n + end + 1, new * n + start, new * n + end + 1
            quads = busy[start + 1 : end + 1]
            _sort_out(state[a:b], across[a:b], down[a:b], state[c:d], across[c:d], down[c:d], quads)
            draw_quads(
                flat, at, u, v, w, state, across, down, quads, a, c, todo, limits, shape, inverse_z, source, counts
            )
            b, d = b - 1, d - 1
            _link(busy[start : end + 1], at[a:b], state[a:b], linked[a:b], linked[c:d], alone)
            _at_rim(state[a : b + 1], state[c : d + 1], rim[start:end])
            n_late = _listed(rim[start:end], start, late)
            busy[start : end + 1] = 0
        row += 1


@njit(**BORROWED)
def _skip(source_index, order, place, before, alone):
    """Set in `alone` the points up to source pixel `before`, which lie between the rows of a strided cloud."""
    while place < source_index.shape[0]:
        i = order[place] if order.shape[0] > 0 else np.int64(place)
        if source_index[i] >= before:
            break
        alone[i] = True
        place += 1
    return place


@njit(**BORROWED)
def _at_rim(state, state_1, rim):
    """Which quads have some of their corners and lack others, none of them behind the lens."""
    for c in range(rim.shape[0]):
        i, j, k, m = state[c], state[c + 1], state_1[c], state_1[c + 1]
        some, every = i | j | k | m, i & j & k & m
        rim[c] = (some & ~every & THERE) if some & UNSEEN == 0 else 0


@njit(**BORROWED)
def _listed(marked, start, out):
    """Write the columns that are marked, from `start` on; few are, so eight are looked at in one; returns how many."""
    n = 0
    words = marked.view(np.uint64)
    for k in range(words.shape[0]):
        if words[k] != 0:
            for c in range(8 * k, 8 * k + 8):
                out[n] = start + c
                n += marked[c]
    return n


@njit(**BORROWED)
def _find(source_index, order, place, row, cols, stride, at, alone):
    """Write the points of one source row into their columns; returns (first column, end, where the next row begins).

    What lies between the columns of a strided cloud, or shares its source pixel, stands alone.
    """
    begin = row * cols
    if stride == 1 and order.shape[0] == 0:
        after = place + np.searchsorted(source_index[place : place + cols], begin + cols)
        columns = source_index[place:after]
        first = columns[0] - begin
        if columns[columns.shape[0] - 1] - begin - first + 1 == columns.shape[0]:
            for k in range(columns.shape[0]):
                at[first + k] = place + k
        else:
            for k in range(columns.shape[0]):
                at[columns[k] - begin] = place + k
        return first, columns[columns.shape[0] - 1] - begin + 1, after
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


@njit(**BORROWED)
def _gather(flat, at, spread):
    for c in range(at.shape[0]):
        i = 3 * max(at[c], 0)
        spread[3 * c], spread[3 * c + 1], spread[3 * c + 2] = flat[i], flat[i + 1], flat[i + 2]


@njit(**BORROWED)
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
        state[c] = np.uint8(THERE if ok else (THERE | UNSEEN if there else 0))


@njit(**BORROWED)
def _sort_out(state, across, down, state_1, across_1, down_1, busy):
    """What is to be done with each quad: 0 no quad, 1 no pixel centre near it, 2 draw, BEHIND_LENS a corner behind.

    Corners have bits THERE and UNSEEN in `state`. A box holds no centre if all four lie between the same two, in x
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
        busy[c] = np.uint8(0 if three & THERE == 0 else (BEHIND_LENS if (i | j | k | m) & UNSEEN != 0 else box))


@njit(**BORROWED)
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
