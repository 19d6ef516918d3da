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
def to_grid(source_index, first_row, grid):
    """Write the number of each point into `grid` (rows, cols), which starts at `first_row`; returns the columns used.

    The row of the point before usually is that of the next one, which saves a division.
    """
    cols = grid.shape[1]
    row, start = 0, first_row * cols
    low, high = cols, -1
    for i in range(source_index.shape[0]):
        col = source_index[i] - start
        if not 0 <= col < cols:
            row = source_index[i] // cols - first_row
            start = (row + first_row) * cols
            col = source_index[i] - start
        grid[row, col] = i
        low, high = min(low, col), max(high, col)
    return low, high


@njit(cache=True, error_model="numpy")
def neighbour_distances(points, grid, stride, every, z_min, out):
    """Write the distances of points that are neighbours in every `every`-th row of the grid; returns how many."""
    n = 0
    for r in range(0, grid.shape[0], every):
        for c in range(0, grid.shape[1] - stride):
            i, j = grid[r, c], grid[r, c + stride]
            if i < 0 or j < 0 or n >= out.shape[0] or not (points[i, 2] > z_min and points[j, 2] > z_min):
                continue
            d_sq = 0.0
            for axis in range(3):
                d = np.float64(points[i, axis]) - np.float64(points[j, axis])
                d_sq += d * d
            if d_sq < np.inf:
                out[n] = math.sqrt(d_sq)
                n += 1
    return n


@njit(cache=True, error_model="numpy")
def rasterise(flat, grid, columns, stride, lens, shape, z_min, limits, inverse_z, source, alone, counts):
    """Draw the source grid as triangles.

    `flat` (3 n) holds the points, `grid` (rows, cols) the number of the point of each source pixel, -1 = none; every
    `stride`-th of the columns from `columns[0]` up to and with `columns[1]` is looked at. `limits` are the longest
    edge, mm, squared, and the smallest cosine between normal and line of sight. Writes inverse_z and source of the
    target image, flat; clears in `alone` the points that have neighbours to form a triangle with, drawn or not; and
    counts, by fate, the triangles that cover a pixel centre.
    """
    n = (columns[1] - columns[0]) // stride + 1
    at = np.full(2 * n, -1, dtype=np.int32)  # two rows in turn: the point of each column,
    x, y, z = np.zeros(2 * n), np.zeros(2 * n), np.zeros(2 * n)  # where it is,
    u, v, w = np.zeros(2 * n), np.zeros(2 * n), np.zeros(2 * n)  # where it is seen, px, and its 1/z
    state = np.zeros(2 * n, dtype=np.uint8)
    left, right, top, bottom = (  # the first pixel centre not before it and the last not after it
        np.zeros(2 * n, dtype=np.int32), np.zeros(2 * n, dtype=np.int32),
        np.zeros(2 * n, dtype=np.int32), np.zeros(2 * n, dtype=np.int32),
    )  # fmt: skip
    busy = np.zeros(n, dtype=np.uint8)
    for r in range(0, grid.shape[0], stride):
        turn = (r // stride) % 2 * n
        _load(flat, grid[r], columns[0], stride, turn, n, at, x, y, z)
        _see(x, y, z, at, lens, z_min, turn, n, u, v, w, state)
        _between(u, left, right, shape[1], turn, n)
        _between(v, top, bottom, shape[0], turn, n)
        if r == 0:
            continue
        _sort_out(state, left, right, top, bottom, n, busy)
        _draw_row(at, x, y, z, u, v, w, state, busy, n - turn, turn, limits, shape, inverse_z, source, alone, counts)


@njit(cache=True)
def _load(flat, row, first, stride, turn, n, at, x, y, z):
    for c in range(n):
        i = row[first + c * stride]
        at[turn + c] = i
        if i >= 0:
            x[turn + c], y[turn + c], z[turn + c] = flat[3 * i], flat[3 * i + 1], flat[3 * i + 2]


@njit(cache=True, error_model="numpy")
def _see(x, y, z, at, lens, z_min, turn, n, u, v, w, state):
    """Screen coordinates of a row of corners; the image's middle, harmlessly, for those that have none."""
    fx, fy, cx, cy = lens
    for c in range(turn, turn + n):
        there = at[c] >= 0
        ok = there & (z[c] > z_min) & (z[c] < np.inf) & (abs(x[c]) < np.inf) & (abs(y[c]) < np.inf)
        w[c] = 1.0 / (z[c] if ok else 1.0)
        u[c] = fx * (x[c] if ok else 0.0) * w[c] + cx
        v[c] = fy * (y[c] if ok else 0.0) * w[c] + cy
        state[c] = np.uint8(1 if ok else (_BEHIND if there else 0))


@njit(cache=True)
def _between(u, first, last, size, turn, n):
    """The pixel centres that lie around each coordinate, clamped as floats to just outside the image."""
    for c in range(turn, turn + n):
        near = min(max(u[c], -2.0), size + 1.0)
        first[c], last[c] = np.int32(np.ceil(near - SLACK)), np.int32(np.floor(near + SLACK))


@njit(cache=True)
def _sort_out(state, left, right, top, bottom, n, busy):
    """What is to be done with each quad: 0 no quad, 1 no pixel centre near it, 2 draw, _BEHIND a corner behind."""
    for c in range(n - 1):
        a, b, d, e = c, c + 1, n + c, n + c + 1
        total = state[a] + state[b] + state[d] + state[e]
        corners = (total & 15) + (total >> 4)
        across = min(left[a], left[b], left[d], left[e]) <= max(right[a], right[b], right[d], right[e])
        down = min(top[a], top[b], top[d], top[e]) <= max(bottom[a], bottom[b], bottom[d], bottom[e])
        # With a corner missing its stand-in may widen the box, which costs a look and no more.
        drawn = 2 if across & down else 1
        busy[c] = np.uint8(0 if corners < 3 else (_BEHIND if total >= _BEHIND else drawn))


@njit(cache=True, error_model="numpy")
def _draw_row(at, x, y, z, u, v, w, state, busy, before, turn, limits, shape, inverse_z, source, alone, counts):
    """Draw a row of quads: two triangles along the shorter diagonal, which follows a crease; one if a corner lacks."""
    for c in range(busy.shape[0] - 1):
        if busy[c] == 0:
            continue
        a, b, d, e = before + c, before + c + 1, turn + c, turn + c + 1
        for k in (a, b, d, e):
            if at[k] >= 0:
                alone[at[k]] = False
        if busy[c] == 1:
            continue
        if busy[c] == _BEHIND:
            counts[BEHIND] += 1
            continue
        i, j, k = a, b, d
        again = False
        if state[a] == 0:
            i, j, k = b, e, d
        elif state[b] == 0:
            i, j, k = a, e, d
        elif state[d] == 0:
            i, j, k = a, b, e
        elif state[e] != 0:
            again = True
            if _distance_sq(x, y, z, a, e) < _distance_sq(x, y, z, b, d):
                i, j, k = a, b, e
        for t in range(2):
            if t == 1:
                if not again:
                    break
                i, j, k = (a, e, d) if k == e else (b, e, d)
            _draw(at, x, y, z, u, v, w, i, j, k, limits, shape, inverse_z, source, counts)


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
def _draw(at, x, y, z, u, v, w, i, j, k, limits, shape, inverse_z, source, counts):
    """Draw one triangle; what it is worth is asked only once it covers a pixel centre."""
    xa, ya, xb, yb, xc, yc = u[i], v[i], u[j], v[j], u[k], v[k]
    area = (xb - xa) * (yc - ya) - (xc - xa) * (yb - ya)
    rows, cols = shape
    # In float until both ends are inside the image: what an integer cannot hold would come out as something else.
    first = np.int64(np.ceil(max(min(xa, xb, xc) - SLACK, 0.0)))
    last = np.int64(np.floor(min(max(xa, xb, xc) + SLACK, cols - 1.0)))
    top = np.int64(np.ceil(max(min(ya, yb, yc) - SLACK, 0.0)))
    bottom = np.int64(np.floor(min(max(ya, yb, yc) + SLACK, rows - 1.0)))
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
            p = r * cols + c
            if near > inverse_z[p]:
                inverse_z[p] = near
                # The corner with the largest weight is the nearest one on screen.
                source[p] = at[i] if a >= b and a >= g else (at[j] if b >= g else at[k])
