# pyright: basic
"""Compiled loops of the surface mode: quads and triangles of the source grid, drawn where they cover a pixel centre.

Corners are kept by column: `at` is the point of each, (u, v) where it is seen, px, w its 1/z, `across` and `down` the
pixel centres it lies between (see `between`). `limits` are the longest edge, mm, squared, and the smallest cosine
between a triangle's normal and the line of sight; `shape` is (rows, cols) of the target image, which is written flat.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

# Arrays are borrowed for a call: counting references to them, row by row, took half the time. Nothing is allocated.
BORROWED: Any = {"cache": True, "error_model": "numpy", "_nrt": False}
SLACK = 1e-9  # barycentric and px: neighbours share the pixels on their common edge, so that no crack opens
JUMP, GRAZING, BEHIND, FLIPPED, KEPT = 0, 1, 2, 3, 4  # what becomes of a triangle: FLIPPED and KEPT are drawn,
CROWDED, SPENT = 5, 6  # too much was drawn before it; and how many pixels large triangles have taken so far
N_COUNTS = 7
THERE, UNSEEN = 1, 2  # bits of a corner: a point, and one behind the lens or not finite
BEHIND_LENS = 16  # of a quad with such a corner
_DRAW = 2  # from here on a quad wants a look
LARGE_PX = 16  # pixels of a triangle's box from which on it is asked first whether it is worth drawing
LAYERS = (
    8  # times that large triangles may fill the image: surfaces fold over once or twice, noise at the lens endlessly
)


@njit(**BORROWED)
def between(u, place, size):
    """The pixel centres that each coordinate lies between, as first not before + last not after.

    That sum is even on a centre, to the slack, and odd between two: half of it, rounded up and down, gives them back.
    Clamped as floats to between two centres outside the image.
    """
    high = size + 0.5
    for c in range(u.shape[0]):
        near = u[c] if u[c] > -1.5 else -1.5
        near = near if near < high else high
        place[c] = np.int32(np.ceil(near - SLACK)) + np.int32(np.floor(near + SLACK))


@njit(**BORROWED)
def draw_quads(
    flat, at, u, v, w, state, across, down, busy, above, below, todo, limits, shape, inverse_z, source, counts
):
    """Draw a row of quads: two triangles along the shorter diagonal, which follows a crease; one if a corner lacks."""
    n = 0
    for column in range(busy.shape[0]):  # no branch: which quads hold a centre is beyond guessing
        todo[n] = column
        n += busy[column] >= _DRAW
    # Unsigned places, which cannot count from an array's end: numba's checks for that were a third of the work.
    above, below, one, two, three = np.uint64(above), np.uint64(below), np.uint64(1), np.uint64(2), np.uint64(3)
    for turn in range(n):
        column = np.uint64(todo[turn])
        if busy[column] == BEHIND_LENS:
            counts[BEHIND] += 1
            continue
        a, b, d, e = above + column, above + column + one, below + column, below + column + one
        if (state[a] & state[b] & state[d] & state[e]) == 0:
            i, j, k = _three(np.int64(a), np.int64(b), np.int64(d), np.int64(e), state)
            draw(flat, at, at, u, v, w, across, down, i, j, k, limits, shape, inverse_z, source, counts)
            continue
        # The triangles are (i, j, k) and, beyond the edge j-k, (j, o, k). Written as choices of numbers, since a
        # branch that goes either way costs more than what it saves.
        ia, ib = three * np.uint64(at[a]), three * np.uint64(at[b])
        ic, ie = three * np.uint64(at[d]), three * np.uint64(at[e])
        falling = _length_sq(flat[ia] - flat[ie], flat[ia + one] - flat[ie + one], flat[ia + two] - flat[ie + two])
        rising = _length_sq(flat[ib] - flat[ic], flat[ib + one] - flat[ic + one], flat[ib + two] - flat[ic + two])
        if min(falling, rising) > limits[0]:
            counts[JUMP] += 2
            continue
        crossed = falling < rising
        turned = np.uint64(crossed)
        i, j, k, o = a + turned, b + turned * (e - b), d - turned * (d - a), e - turned
        col = (min(across[a], across[b], across[d], across[e]) + 1) >> 1
        row = (min(down[a], down[b], down[d], down[e]) + 1) >> 1
        wide = (max(across[a], across[b], across[d], across[e]) >> 1) - col
        tall = (max(down[a], down[b], down[d], down[e]) >> 1) - row
        if wide == 0 and tall == 0:
            # Most often there is one centre to ask for, and the diagonal says which triangle may have it.
            beyond = (u[k] - u[j]) * (row - v[j]) - (v[k] - v[j]) * (col - u[j])
            side = (u[k] - u[j]) * (v[i] - v[j]) - (v[k] - v[j]) * (u[i] - u[j])
            if abs(beyond) > 4.0 * SLACK * abs(side):
                first = np.uint64(beyond * side > 0.0)
                i, j = j + first * (i - j), o + first * (j - o)
                xa, ya, xb, yb, xc, yc = u[i] - col, v[i] - row, u[j] - col, v[j] - row, u[k] - col, v[k] - row
                area = (xb - xa) * (yc - ya) - (xc - xa) * (yb - ya)
                if area == 0.0 or col < 0 or row < 0 or col >= shape[1] or row >= shape[0]:
                    continue
                scale = 1.0 / area
                wa, wb = (xb * yc - xc * yb) * scale, (xc * ya - xa * yc) * scale
                wc = 1.0 - wa - wb
                if min(wa, wb, wc) < -SLACK:
                    continue
                pa, pb, pc = at[i], at[j], at[k]
                qa, qb, qc = three * np.uint64(pa), three * np.uint64(pb), three * np.uint64(pc)
                fate = _fate(flat[qa], flat[qa + one], flat[qa + two], flat[qb], flat[qb + one], flat[qb + two],
                             flat[qc], flat[qc + one], flat[qc + two], limits[0], limits[1])  # fmt: skip
                counts[fate] += 1
                if fate < FLIPPED:
                    continue
                near = wa * w[i] + wb * w[j] + wc * w[k]
                p = np.uint64(row * shape[1] + col)
                if near > inverse_z[p]:
                    inverse_z[p] = near
                    # The corner with the largest weight is the nearest one on screen.
                    source[p] = _of_largest(wa, wb, wc, pa, pb, pc)
                continue
        if counts[SPENT] > LAYERS * shape[0] * shape[1] and (wide + 1) * (tall + 1) > LARGE_PX:
            counts[CROWDED] += 2
            continue
        p0, p1, p2, p3 = np.int64(i), np.int64(j), np.int64(k), np.int64(o)
        draw(flat, at, at, u, v, w, across, down, p0, p1, p2, limits, shape, inverse_z, source, counts)
        draw(flat, at, at, u, v, w, across, down, p1, p3, p2, limits, shape, inverse_z, source, counts)


@njit(inline="always", **BORROWED)
def _three(a, b, d, e, state):
    """The corners that are there, of a quad that lacks one."""
    if state[a] == 0:
        return b, e, d
    if state[b] == 0:
        return a, e, d
    return (a, b, e) if state[d] == 0 else (a, b, d)


@njit(**BORROWED)
def _of_largest(a, b, c, i, j, k):
    """The number beside the largest of three, the first of equal ones."""
    most, which = (b, j) if b > a else (a, i)
    return k if c > most else which


@njit(**BORROWED)
def _length_sq(dx, dy, dz):
    return dx * dx + dy * dy + dz * dz


@njit(inline="always", **BORROWED)
def _fate(xa, ya, za, xb, yb, zb, xc, yc, zc, max_edge_sq, min_cos):
    """JUMP, GRAZING, FLIPPED or KEPT, by the edges and by the angle between normal and line of sight."""
    x, y, z = np.float64(xa), np.float64(ya), np.float64(za)
    bx, by, bz = xb - x, yb - y, zb - z
    cx, cy, cz = xc - x, yc - y, zc - z
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


@njit(inline="always", **BORROWED)
def draw(flat, at, name, u, v, w, across, down, i, j, k, limits, shape, inverse_z, source, counts):
    """Draw one triangle; what it is worth is asked once it covers a pixel centre, or at once if it is large.

    `name` is what is written to `source` for a corner. Large triangles count against LAYERS.
    """
    xa, ya, xb, yb, xc, yc = u[i], v[i], u[j], v[j], u[k], v[k]
    area = (xb - xa) * (yc - ya) - (xc - xa) * (yb - ya)
    first = max((min(across[i], across[j], across[k]) + 1) >> 1, 0)
    last = min(max(across[i], across[j], across[k]) >> 1, shape[1] - 1)
    top = max((min(down[i], down[j], down[k]) + 1) >> 1, 0)
    bottom = min(max(down[i], down[j], down[k]) >> 1, shape[0] - 1)
    if area == 0.0 or first > last or top > bottom:
        return
    scale = 1.0 / area
    asked = (last - first + 1) * (bottom - top + 1) > LARGE_PX
    pa, pb, pc = 3 * at[i], 3 * at[j], 3 * at[k]
    if asked:
        crowded = counts[SPENT] > LAYERS * shape[0] * shape[1]
        fate = CROWDED if crowded else _fate(
            flat[pa], flat[pa + 1], flat[pa + 2], flat[pb], flat[pb + 1], flat[pb + 2],
            flat[pc], flat[pc + 1], flat[pc + 2], limits[0], limits[1],
        )  # fmt: skip
        counts[fate] += 1
        if fate != FLIPPED and fate != KEPT:
            return
    large, slopes = asked, ((yb - yc) * scale, (yc - ya) * scale, (ya - yb) * scale)
    begin, end = first, last
    for r in range(top, bottom + 1):
        if large:
            a = ((xb - first) * (yc - r) - (xc - first) * (yb - r)) * scale
            b = ((xc - first) * (ya - r) - (xa - first) * (yc - r)) * scale
            begin, end = _span((a, b, 1.0 - a - b), slopes, first, last)
            counts[SPENT] += max(end - begin + 1, 0) + 1
        for c in range(begin, end + 1):
            a = ((xb - c) * (yc - r) - (xc - c) * (yb - r)) * scale
            b = ((xc - c) * (ya - r) - (xa - c) * (yc - r)) * scale
            g = 1.0 - a - b
            if a < -SLACK or b < -SLACK or g < -SLACK:
                continue
            if not asked:
                fate = _fate(flat[pa], flat[pa + 1], flat[pa + 2], flat[pb], flat[pb + 1], flat[pb + 2],
                             flat[pc], flat[pc + 1], flat[pc + 2], limits[0], limits[1])  # fmt: skip
                counts[fate] += 1
                if fate < FLIPPED:
                    return
                asked = True
            near = a * w[i] + b * w[j] + g * w[k]
            p = r * shape[1] + c
            if near > inverse_z[p]:
                inverse_z[p] = near
                source[p] = _of_largest(a, b, g, name[i], name[j], name[k])


@njit(**BORROWED)
def _span(weights, slopes, first, last):
    """The columns of a row in which no weight is negative, to a pixel more on either side.

    `weights` are those at column `first`, `slopes` what they gain per column.
    """
    low, high = 0.0, np.float64(last - first)
    for weight, slope in zip(weights, slopes):  # noqa: B905 - compiled, which knows no strict
        if slope != 0.0:
            zero = -weight / slope
            if slope > 0.0 and zero - 1.0 > low:
                low = zero - 1.0
            elif slope < 0.0 and zero + 1.0 < high:
                high = zero + 1.0
    if not low <= high:
        return first, first - 1
    return first + np.int64(low), first + np.int64(np.ceil(high))
