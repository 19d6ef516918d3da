# pyright: basic
"""Compiled loops of the surface mode: quads as triangles, drawn where they cover a pixel centre.

1/z is linear in screen space; the largest, the point nearest to the camera, wins.

A source pixel stands for its square, so the true border of a mask lies between the last pixel
inside and the first outside. Quads at the rim of a touch, which lack some corners, are therefore
drawn up to the middle of their edges, half a source pixel beyond the outermost points: depth is
extrapolated along the line through a border point and the one behind it, unless those two are
farther apart than the longest edge.

`limits` are the longest edge, mm^2, and the least cosine between a triangle's normal and the line
of sight; the other tuples are described in `projection_kernels` and `quad_kernels`.
"""

from __future__ import annotations

import numpy as np

from pipeline.core.cached_kernels import inner_kernel, kernel
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
from pipeline.stages.target_depth.triangle_batch_kernels import (
    classify_triangles,
    rasterise_triangle,
)

N_RIM_CORNERS = 8  # vertices that the rim of one quad can add, each at a fixed position
ONE = np.uint64(1)
TWO = np.uint64(2)
THREE = np.uint64(3)
FOUR = np.uint64(4)
# Columns of the two triangles in RIM_TRIANGLES; literals would be compiled as two types.
TRIANGLE_OFFSETS = np.int64(1), np.int64(4)


def _tabulate_rims():
    """Rim triangles by which corners of a quad exist (bits): their number, and their corners.

    A corner is an index around the quad, plus 4 for the midpoint toward the previous corner or 8
    toward the next. The midpoints are listed once more in the last four columns, -1 = none.
    """
    table = np.full((16, 11), -1, dtype=np.int64)
    for present in range(1, 15):
        triangles: list[tuple[int, int, int]] = []
        for first in range(4):
            if not present >> first & 1 or present >> ((first + 3) & 3) & 1:
                continue
            last = first  # of a run of corners
            while present >> ((last + 1) & 3) & 1:
                last = (last + 1) & 3
            triangles += [(first, last, 8 + last)] if first != last else []
            triangles += [(first, 8 + last, 4 + first)]
        table[present, 0] = len(triangles)
        table[present, 1 : 1 + 3 * len(triangles)] = np.ravel(triangles)
        midpoints = sorted({k for triangle in triangles for k in triangle if k >= 4})
        table[present, 7 : 7 + len(midpoints)] = midpoints
    return table


RIM_TRIANGLES = _tabulate_rims()


@kernel()
def rasterise_grid(points, bounds, lens, limits, corners, cells, lists, image, counts, alone):
    """Rasterise the triangles of a source grid strip by strip, so that the working data stays in
    cache.

    counts (2, N_COUNTS): triangles by outcome that cover a pixel centre, those of the rim
    separately. A complete quad is split along its shorter diagonal, which follows a crease.

    A strip has as many rows of cells as fit: it draws the quads below all rows but the first and
    the last two, which the rims depend on.
    """
    flat, index, starts = points
    top, _, _, _, stride = bounds
    extra, screen, between_px, state = corners
    corner, state_at, centres, quad = cells
    todo, late, batch = lists
    inverse_z, veil, drawn = image
    _, _, _, _, image_rows, image_cols, _ = lens
    source_rows = starts.shape[0] - 1
    n_rows = corner.shape[0]
    all_rows = (top + source_rows - 1) // stride - top // stride + 1
    for row in range(-2, all_rows - 1, n_rows - 3):
        rows = min(n_rows, all_rows + 2 - row)
        from_row = min(max((row + top // stride) * stride - top, 0), source_rows)
        to_row = min(max((row + rows + top // stride) * stride - top, 0), source_rows)
        start = starts[from_row]
        n = starts[to_row] - starts[from_row]
        here = (flat[3 * start : 3 * (start + n)], extra, screen, between_px)
        of_strip = (corner[:rows], state_at[:rows], centres[:rows], quad[:rows])
        unrolled = (
            of_strip[0].reshape(-1),
            of_strip[1].reshape(-1),
            of_strip[2].reshape(-1),
            of_strip[3].reshape(-1),
        )
        project_corners(lens, n, here, state)
        place_corners(index, starts, bounds, (from_row, to_row, row), state, here, unrolled, alone)
        n_todo, n_behind = classify_quads(of_strip, todo, late)
        mark_isolated_points(of_strip, start, alone)
        counts[0, on.BEHIND] += n_behind
        # a literal would be another type, and `_collect_triangles` compiled twice
        item = np.int64(0)
        while item < n_todo:
            item, n = _collect_triangles(
                todo[:n_todo],
                item,
                of_strip[0],
                here,
                lens,
                limits,
                batch,
                np.uint64(start),
                counts,
            )
            classify_triangles(batch, limits)
            # Inlined: every function that calls another is compiled together with it again.
            for t in range(n):
                outcome = np.uint64(batch[t + on.OUTCOME])
                if outcome == on.NOT_COVERING:
                    continue
                left = np.int64(batch[t + on.LEFT])
                up = np.int64(batch[t + on.TOP])
                if left != batch[t + on.RIGHT] or up != batch[t + on.BOTTOM]:
                    rasterise_triangle(batch, t, image_rows, image_cols, image, counts)
                    continue
                counts[np.uint64(batch[t + on.RIM]), outcome] += 1
                p = np.uint64(up * image_cols + left)
                near = batch[t + on.INVERSE_Z]
                if outcome == on.GRAZING:
                    veil[p] = max(veil[p], near)
                elif outcome > on.GRAZING and near > inverse_z[p]:
                    inverse_z[p] = near
                    drawn[p] = np.int32(batch[t + on.POINT])


@inner_kernel()
def _collect_triangles(todo, item, corner, corners, lens, limits, batch, start, counts):
    """Fill a batch with triangles of the quads from `item` on.

    Returns the next item and the number of triangles.
    """
    at = corner.reshape(-1)
    width = corner.shape[1]
    flat, extra, screen, between_px = corners
    u = screen[0]
    v = screen[1]
    w = screen[2]
    across = between_px[0]
    down = between_px[1]
    n_points = np.uint64(u.shape[0] - N_RIM_CORNERS)
    _, _, _, _, rows, cols, _ = lens
    longest_sq, _ = limits
    t = np.uint64(0)
    while item < todo.shape[0] and t + ONE < on.BATCH_SIZE:
        g = np.int64(todo[item] >> 1)
        rim = np.int64(todo[item] & 1)
        # number of triangles, and the pixel that their weights are relative to
        n = 1
        centre = False
        x0 = 0
        y0 = 0
        here = np.uint64(g)
        below = np.uint64(g + width)
        a = at[here]
        b = at[here + ONE]
        c = at[below]
        d = at[below + ONE]
        if rim:
            present = (
                (a != NO_POINT) | (b != NO_POINT) << 1 | (d != NO_POINT) << 2 | (c != NO_POINT) << 3
            )
            _add_rim_corners(
                g, present, at, width, flat, extra, screen, between_px, lens, longest_sq
            )
            n = RIM_TRIANGLES[present, 0]
            one = _get_rim_triangle(
                RIM_TRIANGLES, present, TRIANGLE_OFFSETS[0], g, at, width, n_points
            )
            two = _get_rim_triangle(
                RIM_TRIANGLES, present, TRIANGLE_OFFSETS[1], g, at, width, n_points
            )
        elif max(a, b, c, d) == NO_POINT:
            one = _pick_three(a, b, c, d)
            two = one
        else:
            # The triangles are (i, j, k) and, beyond the edge j-k, (j, o, k). Conditional values
            # instead of branches, which would be unpredictable.
            falling = _length_sq(flat, a, d)
            rising = _length_sq(flat, b, c)
            if min(falling, rising) > longest_sq:
                counts[0, on.JUMP] += 2
                item += 1
                continue
            turned = falling < rising
            i = b if turned else a
            j = d if turned else b
            k = a if turned else c
            o = c if turned else d
            left, right = _bracket_corners(across, a, b, c, d)
            top, bottom = _bracket_corners(down, a, b, c, d)
            one = (i, j, k)
            two = (j, o, k)
            n = 2
            if left == right and top == bottom:
                # Mostly present is one pixel centre; its side of the diagonal selects the triangle.
                beyond = (u[k] - u[j]) * (top - v[j]) - (v[k] - v[j]) * (left - u[j])
                side = (u[k] - u[j]) * (v[i] - v[j]) - (v[k] - v[j]) * (u[i] - u[j])
                if abs(beyond) > 4.0 * SLACK * abs(side):
                    n = 1
                    centre = True
                    x0 = left
                    y0 = top
                    one = ((i if beyond * side > 0.0 else j), (j if beyond * side > 0.0 else o), k)
            elif (right - left + 1) * (bottom - top + 1) > on.LARGE_PX:
                # the batch so far is drawn first: it may exhaust the pixel budget
                if t > np.uint64(0):
                    break
                if counts[0, on.PIXELS_SPENT] > on.MAX_LAYERS * rows * cols:
                    counts[0, on.OVERFULL] += 2
                    item += 1
                    continue
        for part in range(n):
            i, j, k = one if part == 0 else two
            left = x0
            right = x0
            top = y0
            bottom = y0
            if not centre:
                left, right = _bracket_corners(across, i, j, k, k)
                top, bottom = _bracket_corners(down, i, j, k, k)
            left = max(left, 0)
            right = min(right, cols - 1)
            top = max(top, 0)
            bottom = min(bottom, rows - 1)
            if left > right or top > bottom:
                continue
            to = t
            for corner_at in (i, j, k):
                h = np.uint64(corner_at)
                batch[to + on.AX], batch[to + on.AY], batch[to + on.AZ] = _get_position(
                    flat, extra, h, n_points
                )
                batch[to + on.AU], batch[to + on.AV], batch[to + on.AW] = u[h], v[h], w[h]
                batch[to + on.A_POINT] = start + (
                    h if h < n_points else np.uint64(extra[FOUR * (h - n_points) + THREE])
                )
                to += on.BX
            batch[t + on.LEFT] = left
            batch[t + on.RIGHT] = right
            batch[t + on.TOP] = top
            batch[t + on.BOTTOM] = bottom
            batch[t + on.ORIGIN_X] = x0
            batch[t + on.ORIGIN_Y] = y0
            batch[t + on.RIM] = rim
            t += ONE
        item += 1
    return item, t


@inner_kernel()
def _bracket_corners(place, i, j, k, o):
    """First and last pixel centre between corners."""
    return (min(place[i], place[j], place[k], place[o]) + 1) >> 1, max(
        place[i], place[j], place[k], place[o]
    ) >> 1


@inner_kernel()
def _length_sq(flat, i, j):
    """Squared length of an edge, in the precision of the points."""
    i = 3 * i
    j = 3 * j
    dx = flat[i] - flat[j]
    dy = flat[i + 1] - flat[j + 1]
    dz = flat[i + 2] - flat[j + 2]
    return dx * dx + dy * dy + dz * dz


@inner_kernel()
def _pick_three(a, b, c, d):
    """The three corners of a quad that lacks one."""
    if a == NO_POINT:
        return b, d, c
    if b == NO_POINT:
        return a, d, c
    return (a, b, d) if c == NO_POINT else (a, b, c)


@inner_kernel()
def _get_position(flat, extra, i, n_points):
    """x, y, z of a vertex: of a point, or of the rim."""
    if i < n_points:
        return (
            np.float64(flat[THREE * i]),
            np.float64(flat[THREE * i + ONE]),
            np.float64(flat[THREE * i + TWO]),
        )
    i -= n_points
    return extra[FOUR * i], extra[FOUR * i + ONE], extra[FOUR * i + TWO]


@inner_kernel()
def _add_rim_corners(g, present, at, width, flat, extra, screen, between_px, lens, longest_sq):
    """Write the rim vertices of a quad: half a step beyond its corners, or the corner itself
    without a point behind it.

    RIM_TRIANGLES lists them. Arrays are passed one by one: a tuple of arrays is unpacked with
    reference counting, which takes longer than this function.
    """
    fx, fy, cx, cy, rows, cols, behind = lens
    n_points = screen.shape[1] - N_RIM_CORNERS
    for column in range(7, 11):
        to = RIM_TRIANGLES[present, column] - 4
        if to < 0:
            break
        k = to & 3
        onward = to >> 2
        here = _get_corner_cell(g, width, k)
        missing = _get_corner_cell(g, width, k + 2 * onward - 1)
        i = np.uint64(at[here])
        j = at[np.uint64(2) * here - missing]
        vertex = np.uint64(n_points + to)
        x = np.float64(flat[THREE * i])
        y = np.float64(flat[THREE * i + ONE])
        z = np.float64(flat[THREE * i + TWO])
        if j != NO_POINT and flat[THREE * j + TWO] > behind:
            dx = x - flat[THREE * j]
            dy = y - flat[THREE * j + ONE]
            dz = z - flat[THREE * j + TWO]
            if dx * dx + dy * dy + dz * dz <= longest_sq and z + 0.5 * dz > behind:
                x = x + 0.5 * dx
                y = y + 0.5 * dy
                z = z + 0.5 * dz
        near = 1.0 / z
        extra[4 * to] = x
        extra[4 * to + 1] = y
        extra[4 * to + 2] = z
        extra[4 * to + 3] = i
        u = fx * x * near + cx
        v = fy * y * near + cy
        screen[0, vertex] = u
        screen[1, vertex] = v
        screen[2, vertex] = near
        between_px[0, vertex] = bracket_pixel_centres(u, cols)
        between_px[1, vertex] = bracket_pixel_centres(v, rows)


@inner_kernel()
def _get_corner_cell(g, width, k):
    """Cell of the k-th corner around a quad, clockwise from the upper left.

    -1 and 4 are the last and the first.
    """
    return np.uint64(g + (((k ^ (k >> 1)) & 1) + ((k >> 1) & 1) * width))


@inner_kernel()
def _get_rim_triangle(rims, present, first, g, at, width, n_points):
    """The vertices of one rim triangle."""
    i = rims[present, first]
    j = rims[present, first + 1]
    k = rims[present, first + 2]
    return (
        _get_rim_corner(i, g, at, width, n_points),
        _get_rim_corner(j, g, at, width, n_points),
        _get_rim_corner(k, g, at, width, n_points),
    )


@inner_kernel()
def _get_rim_corner(k, g, at, width, n_points):
    """A quad corner, or a rim vertex for k >= 4."""
    return at[_get_corner_cell(g, width, k)] if k < 4 else np.uint32(n_points + np.uint64(k - 4))
