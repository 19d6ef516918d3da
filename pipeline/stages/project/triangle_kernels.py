# pyright: basic
"""Compiled loops of the surface mode: the triangles of quads, drawn where they cover a pixel centre.

1/z is linear in screen space, and the largest wins: the point nearest to the camera.

A source pixel stands for its square, so the true border of a mask lies between the last pixel inside and the first
outside. Quads at the rim of a touch, which have some of their corners, are therefore drawn up to the middle of their
edges, half a source pixel beyond the outermost points: depth reaches there on the straight line through a border point
and the one behind it, never through two points farther apart than an edge may be.

`limits` are the longest edge, mm^2, and the least cosine between a triangle's normal and the line of sight; the other
tuples are told in `project_kernels` and `surface_kernels`.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from pipeline.base.kept_kernels import kernel
from pipeline.stages.project.surface_kernels import NONE, SLACK, between

# What becomes of a triangle. From GRAZING on it is drawn: that one as a veil, which is not seen and hides.
JUMP, CROWDED, BEHIND, GRAZING, FLIPPED, KEPT = range(6)
SPENT = 6  # how many pixels large triangles have taken so far
N_COUNTS = 7
LARGE_PX = 16  # pixels of a triangle's box from which on it is asked first whether it is worth drawing
LAYERS = (
    8  # times that large triangles may fill the image: surfaces fold over once or twice, noise at the lens endlessly
)
RIM_ROOM = 8  # corners that the rim of one quad adds


@kernel(error_model="numpy")
def draw(todo, corner, corners, lens, limits, image, counts):
    """Draw quads, as `tell_apart` lists them; counts (2, N_COUNTS) by fate the triangles that cover a pixel centre.

    A whole quad is two triangles along the shorter diagonal, which follows a crease. The rim's are counted apart.
    """
    at, width = corner.reshape(-1), corner.shape[1]
    flat, extra, u, v, w, across, down, origin = corners
    n_points = u.shape[0] - RIM_ROOM
    inverse_z, veil, source = image
    _, _, _, _, rows, cols, _ = lens
    longest_sq, _ = limits
    most = LAYERS * rows * cols
    for turn in range(todo.shape[0]):
        g, rim = np.int64(todo[turn] >> 1), np.int64(todo[turn] & 1)
        n, centre, x0, y0 = 1, False, 0, 0  # how many triangles, and the pixel that they are seen from
        here, below = np.uint64(g), np.uint64(g + width)
        a, b, c, d = at[here], at[here + np.uint64(1)], at[below], at[below + np.uint64(1)]
        if rim:
            n, one, two = _rim(g, at, width, corners, lens, longest_sq)
        elif max(a, b, c, d) == NONE:
            one = _three(a, b, c, d)
            two = one
        else:
            # The triangles are (i, j, k) and, beyond the edge j-k, (j, o, k). Written as choices of numbers, since a
            # branch that goes either way costs more than what it saves.
            falling, rising = _length_sq(flat, a, d), _length_sq(flat, b, c)
            if min(falling, rising) > longest_sq:
                counts[0, JUMP] += 2
                continue
            turned = falling < rising
            i, j, k, o = (b if turned else a), (d if turned else b), (a if turned else c), (c if turned else d)
            left, right = _between(across, a, b, c, d)
            top, bottom = _between(down, a, b, c, d)
            one, two, n = (i, j, k), (j, o, k), 2
            if left == right and top == bottom:
                # Most often there is one centre to ask for, and the diagonal says which triangle may have it.
                beyond = (u[k] - u[j]) * (top - v[j]) - (v[k] - v[j]) * (left - u[j])
                side = (u[k] - u[j]) * (v[i] - v[j]) - (v[k] - v[j]) * (u[i] - u[j])
                if abs(beyond) > 4.0 * SLACK * abs(side):
                    n, centre, x0, y0 = 1, True, left, top
                    one = ((i if beyond * side > 0.0 else j), (j if beyond * side > 0.0 else o), k)
            elif counts[0, SPENT] > most and (right - left + 1) * (bottom - top + 1) > LARGE_PX:
                counts[0, CROWDED] += 2
                continue
        for part in range(n):
            i, j, k = one if part == 0 else two
            xa, ya, xb, yb, xc, yc = u[i] - x0, v[i] - y0, u[j] - x0, v[j] - y0, u[k] - x0, v[k] - y0
            area = (xb - xa) * (yc - ya) - (xc - xa) * (yb - ya)
            left, right, top, bottom = 0, 0, 0, 0
            if not centre:
                left, right = _between(across, i, j, k, k)
                top, bottom = _between(down, i, j, k, k)
            left, right = max(left, -x0), min(right, cols - 1 - x0)
            top, bottom = max(top, -y0), min(bottom, rows - 1 - y0)
            if area == 0.0 or left > right or top > bottom:
                continue
            scale = 1.0 / area
            large, fate = (right - left + 1) * (bottom - top + 1) > LARGE_PX, -1
            if large:
                fate = CROWDED if counts[rim, SPENT] > most else _fate(flat, extra, i, j, k, limits)
                counts[rim, fate] += 1
                if fate < GRAZING:
                    continue
            for y in range(top, bottom + 1):
                begin, end = left, right
                if large:
                    wa = ((xb - left) * (yc - y) - (xc - left) * (yb - y)) * scale
                    wb = ((xc - left) * (ya - y) - (xa - left) * (yc - y)) * scale
                    slopes = ((yb - yc) * scale, (yc - ya) * scale, (ya - yb) * scale)
                    begin, end = _columns((wa, wb, 1.0 - wa - wb), slopes, left, right)
                    counts[rim, SPENT] += max(end - begin + 1, 0) + 1
                for x in range(begin, end + 1):
                    wa = ((xb - x) * (yc - y) - (xc - x) * (yb - y)) * scale
                    wb = ((xc - x) * (ya - y) - (xa - x) * (yc - y)) * scale
                    wc = 1.0 - wa - wb
                    if wa < -SLACK or wb < -SLACK or wc < -SLACK:
                        continue
                    if fate < 0:
                        fate = _fate(flat, extra, i, j, k, limits)
                        counts[rim, fate] += 1
                    near, p = wa * w[i] + wb * w[j] + wc * w[k], np.uint64((y + y0) * cols + x + x0)
                    if fate == GRAZING:
                        veil[p] = max(veil[p], near)
                    elif fate > GRAZING and near > inverse_z[p]:
                        inverse_z[p] = near
                        # The corner with the largest weight is the nearest one on screen.
                        largest, won = (wb, j) if wb > wa else (wa, i)
                        won = k if wc > largest else won
                        source[p] = won if won < n_points else origin[won - n_points]


@kernel(error_model="numpy")
def _between(place, i, j, k, o):
    """The first and the last pixel centre between corners."""
    return (min(place[i], place[j], place[k], place[o]) + 1) >> 1, max(place[i], place[j], place[k], place[o]) >> 1


@kernel(error_model="numpy")
def _length_sq(flat, i, j):
    """Of an edge, in the precision of the points."""
    i, j = 3 * i, 3 * j
    dx, dy, dz = flat[i] - flat[j], flat[i + 1] - flat[j + 1], flat[i + 2] - flat[j + 2]
    return dx * dx + dy * dy + dz * dz


@kernel(error_model="numpy")
def _three(a, b, c, d):
    """The corners that are there, of a quad that lacks one."""
    if a == NONE:
        return b, d, c
    if b == NONE:
        return a, d, c
    return (a, b, d) if c == NONE else (a, b, c)


@kernel(error_model="numpy")
def _fate(flat, extra, i, j, k, limits):
    """JUMP, GRAZING, FLIPPED or KEPT, by the edges and by the angle between normal and line of sight."""
    longest_sq, least_cos = limits
    x, y, z = _place_of(flat, extra, i)
    bx, by, bz = _place_of(flat, extra, j)
    cx, cy, cz = _place_of(flat, extra, k)
    bx, by, bz, cx, cy, cz = bx - x, by - y, bz - z, cx - x, cy - y, cz - z
    dx, dy, dz = cx - bx, cy - by, cz - bz
    if not (
        bx * bx + by * by + bz * bz <= longest_sq
        and cx * cx + cy * cy + cz * cz <= longest_sq
        and dx * dx + dy * dy + dz * dz <= longest_sq
    ):
        return JUMP
    nx, ny, nz = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
    mx, my, mz = x + (bx + cx) / 3.0, y + (by + cy) / 3.0, z + (bz + cz) / 3.0
    along = nx * mx + ny * my + nz * mz
    limit_sq = least_cos * least_cos * (nx * nx + ny * ny + nz * nz) * (mx * mx + my * my + mz * mz)
    if not (along * along >= limit_sq and along != 0.0):
        return GRAZING
    return KEPT if along > 0.0 else FLIPPED


@kernel(error_model="numpy")
def _place_of(flat, extra, i):
    """x, y, z of a corner: of a point, or of the room beyond them."""
    i = np.int64(3 * i)
    if i < flat.shape[0]:
        return np.float64(flat[i]), np.float64(flat[i + 1]), np.float64(flat[i + 2])
    i -= flat.shape[0]
    return extra[i], extra[i + 1], extra[i + 2]


@kernel(error_model="numpy")
def _columns(weights, slopes, first, last):
    """The columns of a row in which no weight is negative, to a pixel more on either side.

    `weights` are those at column `first`, `slopes` what they gain per column.
    """
    low, high = 0.0, np.float64(last - first)
    for k in range(3):
        if slopes[k] != 0.0:
            zero = -weights[k] / slopes[k]
            if slopes[k] > 0.0 and zero - 1.0 > low:
                low = zero - 1.0
            elif slopes[k] < 0.0 and zero + 1.0 < high:
                high = zero + 1.0
    if not low <= high:
        return first, first - 1
    return first + np.int64(low), first + np.int64(np.ceil(high))


@njit(cache=True, error_model="numpy", inline="always")
def _rim(g, at, width, corners, lens, longest_sq):
    """How many triangles (one or two) a quad is worth that lacks corners, and these; three have had theirs already."""
    turn = (g, g + 1, g + width + 1, g + width)  # round the quad
    n, one, two = 0, (NONE, NONE, NONE), (NONE, NONE, NONE)
    for first in range(4):
        if at[turn[first]] == NONE or at[turn[(first + 3) & 3]] != NONE:
            continue
        last = first  # of the corners in a run
        while at[turn[(last + 1) & 3]] != NONE:
            last = (last + 1) & 3
        start, end = at[turn[first]], at[turn[last]]
        inner = at[2 * turn[first] - turn[(first + 3) & 3]]
        back = _beyond(start, inner, corners, lens, longest_sq, first)
        inner = at[2 * turn[last] - turn[(last + 1) & 3]]
        onward = _beyond(end, inner, corners, lens, longest_sq, 4 + last)
        if first != last:
            one, two, n = (start, end, onward), (start, onward, back), 2
        elif n == 0:
            one, n = (start, onward, back), 1
        else:
            two, n = (start, onward, back), 2
    return n, one, two


@kernel(error_model="numpy")
def _beyond(here, inner, corners, lens, longest_sq, to):
    """The corner half a step beyond `here`, coming from the `inner` one, put at `to`; `here`, if there is none."""
    fx, fy, cx, cy, rows, cols, behind = lens
    flat, extra, u, v, w, across, down, origin = corners
    if inner == NONE or not flat[3 * inner + 2] > behind:
        return here
    i, j = 3 * here, 3 * inner
    x, y, z = np.float64(flat[i]), np.float64(flat[i + 1]), np.float64(flat[i + 2])
    dx, dy, dz = x - flat[j], y - flat[j + 1], z - flat[j + 2]
    x, y, z = x + 0.5 * dx, y + 0.5 * dy, z + 0.5 * dz
    if not (dx * dx + dy * dy + dz * dz <= longest_sq and z > behind):
        return here
    spare, near = u.shape[0] - RIM_ROOM + to, 1.0 / z
    extra[3 * to], extra[3 * to + 1], extra[3 * to + 2] = x, y, z
    u[spare], v[spare], w[spare] = fx * x * near + cx, fy * y * near + cy, near
    across[spare], down[spare], origin[to] = between(u[spare], cols), between(v[spare], rows), here
    return np.uint32(spare)
