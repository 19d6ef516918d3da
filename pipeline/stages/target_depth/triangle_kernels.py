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

from pipeline.base.cached_kernels import inner_kernel, kernel
from pipeline.stages.target_depth import triangle_batch_kernels as on
from pipeline.stages.target_depth.quad_kernels import (
    NO_POINT,
    SLACK,
    bracket_pixel_centres,
    classify_quads,
    mark_isolated_points,
    place_corners,
    project_corners,
)
from pipeline.stages.target_depth.triangle_batch_kernels import classify_triangles, rasterise_triangle

N_RIM_CORNERS = 8  # corners that the rim of one quad adds, each at a place of its own
ONE, TWO, THREE, FOUR = np.uint64(1), np.uint64(2), np.uint64(3), np.uint64(4)
TRIANGLE_OFFSETS = (
    np.int64(1),
    np.int64(4),
)  # of the corners of either triangle in RIMS; as bare constants they would be two types


def _told_of_rims():
    """By which corners round a quad are there (bits): how many triangles its rim is worth, and the corners of these.

    A corner is a place round the quad, 4 more for what lies beyond it going back, or 8 more going on. The latter two
    are listed once more, in the last four columns, -1 = none.
    """
    told = np.full((16, 11), -1, dtype=np.int64)
    for there in range(1, 15):
        triangles: list[tuple[int, int, int]] = []
        for first in range(4):
            if not there >> first & 1 or there >> ((first + 3) & 3) & 1:
                continue
            last = first  # of a run of corners
            while there >> ((last + 1) & 3) & 1:
                last = (last + 1) & 3
            triangles += [(first, last, 8 + last)] if first != last else []
            triangles += [(first, 8 + last, 4 + first)]
        told[there, 0] = len(triangles)
        told[there, 1 : 1 + 3 * len(triangles)] = np.ravel(triangles)
        beyond = sorted({k for triangle in triangles for k in triangle if k >= 4})
        told[there, 7 : 7 + len(beyond)] = beyond
    return told


RIM_TRIANGLES = _told_of_rims()


@kernel()
def rasterise_grid(points, bounds, lens, limits, corners, cells, lists, image, counts, alone):
    """Draw the triangles of a source grid, strip by strip of it, so that what is laid out of it stays in fast memory.

    counts (2, N_COUNTS): by fate the triangles that cover a pixel centre, those of the rim apart. A whole quad is two
    triangles along the shorter diagonal, which follows a crease.

    A strip is as many rows of cells as there is room for: the quads below all but the first and the last two are its
    own, which hang on the others too.
    """
    flat, index, starts = points
    top, _, _, _, stride = bounds
    extra, screen, between_px, state = corners
    corner, state_at, centres, quad = cells
    todo, late, desk = lists
    inverse_z, veil, drawn = image
    _, _, _, _, image_rows, image_cols, _ = lens
    source_rows, n_rows = starts.shape[0] - 1, corner.shape[0]
    all_rows = (top + source_rows - 1) // stride - top // stride + 1
    for row in range(-2, all_rows - 1, n_rows - 3):
        rows = min(n_rows, all_rows + 2 - row)
        from_row = min(max((row + top // stride) * stride - top, 0), source_rows)
        to_row = min(max((row + rows + top // stride) * stride - top, 0), source_rows)
        start, n = starts[from_row], starts[to_row] - starts[from_row]
        here = (flat[3 * start : 3 * (start + n)], extra, screen, between_px)
        of_strip = (corner[:rows], state_at[:rows], centres[:rows], quad[:rows])
        unrolled = (
            of_strip[0].reshape(-1), of_strip[1].reshape(-1), of_strip[2].reshape(-1), of_strip[3].reshape(-1),
        )  # fmt: skip
        project_corners(lens, n, here, state)
        place_corners(index, starts, bounds, (from_row, to_row, row), state, here, unrolled, alone)
        n_todo, n_behind = classify_quads(of_strip, todo, late)
        mark_isolated_points(of_strip, start, alone)
        counts[0, on.BEHIND] += n_behind
        turn = np.int64(0)  # as a constant it would be a type of its own, and `_lay` compiled for both
        while turn < n_todo:
            turn, n = _lay(todo[:n_todo], turn, of_strip[0], here, lens, limits, desk, np.uint64(start), counts)
            classify_triangles(desk, limits)
            # Drawn here and not in a function of its own: each that calls another is compiled together with it again.
            for t in range(n):
                fate = np.uint64(desk[t + on.OUTCOME])
                if fate == on.NOT_COVERING:
                    continue
                left, up = np.int64(desk[t + on.LEFT]), np.int64(desk[t + on.TOP])
                if left != desk[t + on.RIGHT] or up != desk[t + on.BOTTOM]:
                    rasterise_triangle(desk, t, image_rows, image_cols, image, counts)
                    continue
                counts[np.uint64(desk[t + on.RIM]), fate] += 1
                p, near = np.uint64(up * image_cols + left), desk[t + on.INVERSE_Z]
                if fate == on.GRAZING:
                    veil[p] = max(veil[p], near)
                elif fate > on.GRAZING and near > inverse_z[p]:
                    inverse_z[p] = near
                    drawn[p] = np.int32(desk[t + on.POINT])


@inner_kernel()
def _lay(todo, turn, corner, corners, lens, limits, desk, start, counts):
    """Lay triangles on the desk, of the quads from `turn` on; which turn is next, and how many triangles there are."""
    at, width = corner.reshape(-1), corner.shape[1]
    flat, extra, screen, between_px = corners
    u, v, w = screen[0], screen[1], screen[2]
    across, down = between_px[0], between_px[1]
    n_points = np.uint64(u.shape[0] - N_RIM_CORNERS)
    _, _, _, _, rows, cols, _ = lens
    longest_sq, _ = limits
    t = np.uint64(0)
    while turn < todo.shape[0] and t + ONE < on.BATCH_SIZE:
        g, rim = np.int64(todo[turn] >> 1), np.int64(todo[turn] & 1)
        n, centre, x0, y0 = 1, False, 0, 0  # how many triangles, and the pixel that they are seen from
        here, below = np.uint64(g), np.uint64(g + width)
        a, b, c, d = at[here], at[here + ONE], at[below], at[below + ONE]
        if rim:
            there = (a != NO_POINT) | (b != NO_POINT) << 1 | (d != NO_POINT) << 2 | (c != NO_POINT) << 3
            _extend(g, there, at, width, flat, extra, screen, between_px, lens, longest_sq)
            n = RIM_TRIANGLES[there, 0]
            one = _three_of(RIM_TRIANGLES, there, TRIANGLE_OFFSETS[0], g, at, width, n_points)
            two = _three_of(RIM_TRIANGLES, there, TRIANGLE_OFFSETS[1], g, at, width, n_points)
        elif max(a, b, c, d) == NO_POINT:
            one = _three(a, b, c, d)
            two = one
        else:
            # The triangles are (i, j, k) and, beyond the edge j-k, (j, o, k). Written as choices of numbers, since a
            # branch that goes either way costs more than what it saves.
            falling, rising = _length_sq(flat, a, d), _length_sq(flat, b, c)
            if min(falling, rising) > longest_sq:
                counts[0, on.JUMP] += 2
                turn += 1
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
            elif (right - left + 1) * (bottom - top + 1) > on.LARGE_PX:
                if t > np.uint64(0):  # those on the desk go first: they may crowd this one out
                    break
                if counts[0, on.PIXELS_SPENT] > on.MAX_LAYERS * rows * cols:
                    counts[0, on.OVERFULL] += 2
                    turn += 1
                    continue
        for part in range(n):
            i, j, k = one if part == 0 else two
            left, right, top, bottom = x0, x0, y0, y0
            if not centre:
                left, right = _between(across, i, j, k, k)
                top, bottom = _between(down, i, j, k, k)
            left, right = max(left, 0), min(right, cols - 1)
            top, bottom = max(top, 0), min(bottom, rows - 1)
            if left > right or top > bottom:
                continue
            to = t
            for corner_at in (i, j, k):
                h = np.uint64(corner_at)
                desk[to + on.AX], desk[to + on.AY], desk[to + on.AZ] = _place_of(flat, extra, h, n_points)
                desk[to + on.AU], desk[to + on.AV], desk[to + on.AW] = u[h], v[h], w[h]
                desk[to + on.A_POINT] = start + (h if h < n_points else np.uint64(extra[FOUR * (h - n_points) + THREE]))
                to += on.BX
            desk[t + on.LEFT], desk[t + on.RIGHT], desk[t + on.TOP], desk[t + on.BOTTOM] = left, right, top, bottom
            desk[t + on.ORIGIN_X], desk[t + on.ORIGIN_Y], desk[t + on.RIM] = x0, y0, rim
            t += ONE
        turn += 1
    return turn, t


@inner_kernel()
def _between(place, i, j, k, o):
    """The first and the last pixel centre between corners."""
    return (min(place[i], place[j], place[k], place[o]) + 1) >> 1, max(place[i], place[j], place[k], place[o]) >> 1


@inner_kernel()
def _length_sq(flat, i, j):
    """Of an edge, in the precision of the points."""
    i, j = 3 * i, 3 * j
    dx, dy, dz = flat[i] - flat[j], flat[i + 1] - flat[j + 1], flat[i + 2] - flat[j + 2]
    return dx * dx + dy * dy + dz * dz


@inner_kernel()
def _three(a, b, c, d):
    """The corners that are there, of a quad that lacks one."""
    if a == NO_POINT:
        return b, d, c
    if b == NO_POINT:
        return a, d, c
    return (a, b, d) if c == NO_POINT else (a, b, c)


@inner_kernel()
def _place_of(flat, extra, i, n_points):
    """x, y, z of a corner: of a point, or of the room beyond them."""
    if i < n_points:
        return np.float64(flat[THREE * i]), np.float64(flat[THREE * i + ONE]), np.float64(flat[THREE * i + TWO])
    i -= n_points
    return extra[FOUR * i], extra[FOUR * i + ONE], extra[FOUR * i + TWO]


@inner_kernel()
def _extend(g, there, at, width, flat, extra, screen, between_px, lens, longest_sq):
    """Lay down what a quad's rim hangs on: the corners half a step beyond those of the quad, and itself where none is.

    Which there are is told in RIMS. Arrays come one by one: a tuple of them is taken apart with a count of who holds
    each, which takes longer than all of this.
    """
    fx, fy, cx, cy, rows, cols, behind = lens
    n_points = screen.shape[1] - N_RIM_CORNERS
    for listed in range(7, 11):
        to = RIM_TRIANGLES[there, listed] - 4
        if to < 0:
            break
        k, onward = to & 3, to >> 2
        here, missing = _round(g, width, k), _round(g, width, k + 2 * onward - 1)
        i, j, spare = np.uint64(at[here]), at[np.uint64(2) * here - missing], np.uint64(n_points + to)
        x, y, z = np.float64(flat[THREE * i]), np.float64(flat[THREE * i + ONE]), np.float64(flat[THREE * i + TWO])
        if j != NO_POINT and flat[THREE * j + TWO] > behind:
            dx, dy, dz = x - flat[THREE * j], y - flat[THREE * j + ONE], z - flat[THREE * j + TWO]
            if dx * dx + dy * dy + dz * dz <= longest_sq and z + 0.5 * dz > behind:
                x, y, z = x + 0.5 * dx, y + 0.5 * dy, z + 0.5 * dz
        near = 1.0 / z
        extra[4 * to], extra[4 * to + 1], extra[4 * to + 2], extra[4 * to + 3] = x, y, z, i
        u, v = fx * x * near + cx, fy * y * near + cy
        screen[0, spare], screen[1, spare], screen[2, spare] = u, v, near
        between_px[0, spare], between_px[1, spare] = bracket_pixel_centres(u, cols), bracket_pixel_centres(v, rows)


@inner_kernel()
def _round(g, width, k):
    """The k-th corner round a quad, from its upper left to the right, and on; -1 and 4 are the last and the first."""
    return np.uint64(g + (((k ^ (k >> 1)) & 1) + ((k >> 1) & 1) * width))


@inner_kernel()
def _three_of(rims, there, first, g, at, width, n_points):
    """The corners of a triangle of a rim."""
    i, j, k = rims[there, first], rims[there, first + 1], rims[there, first + 2]
    return (
        _corner(i, g, at, width, n_points),
        _corner(j, g, at, width, n_points),
        _corner(k, g, at, width, n_points),
    )


@inner_kernel()
def _corner(k, g, at, width, n_points):
    return at[_round(g, width, k)] if k < 4 else np.uint32(n_points + np.uint64(k - 4))
