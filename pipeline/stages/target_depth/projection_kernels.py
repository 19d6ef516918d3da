# pyright: basic
"""Compiled loops of the projection: pixel of each point, triangles of the source grid, depth and
contact of the drawn image.

Pixel centres are at integer coordinates; a pixel owns the half-open square from -0.5 to +0.5.
Points are flat (3 n) float32, images flat in row-major order. Related arguments are plain tuples
(numba's cache does not survive the renaming of named tuples):

    lens   fx, fy, cx, cy, rows, cols, and the depth up to which a point is behind the lens
    rest   the target's membrane at rest: x0, y0, 1 / step, z (ny nx,), nx, ny
    image  drawing buffers, the largest 1/z wins its pixel: 1/z, 0 = nothing; 1/z of the veil
           (omitted triangles, which still hide what lies behind them); the point drawn, -1 = none

A source pixel stands for its square, so the true border of a mask lies between the last pixel
inside and the first outside. Quads at the rim of a touch, which lack some corners, are therefore
drawn up to the middle of their edges, half a source pixel beyond the outermost points: depth is
extrapolated along the line through a border point and the one behind it, unless those two are
farther apart than the longest edge.
"""

from __future__ import annotations

import numpy as np

from pipeline.core.cached_kernels import inner_kernel, kernel
from pipeline.core.geometry.membrane_kernels import sample_height

MIN_INVERSE_Z = 1.0 / float(np.finfo(np.float32).max)  # 1/mm
# barycentric and px: neighbours share pixels on their common edge, so that no crack opens
SLACK = 1e-9
# Outcome of a triangle. From GRAZING on it is drawn, GRAZING as a veil: invisible, but hiding what
# is behind.
JUMP, OVERFULL, BEHIND, GRAZING, FLIPPED, DRAWN = range(6)
PIXELS_SPENT = 6  # counter: pixels that large triangles have visited
N_COUNTS = 7
LARGE_PX = 16  # pixels of the box from which on a triangle counts as large
# Times that large triangles may fill the image: surfaces overlap once or twice, noise close to the
# lens endlessly.
MAX_LAYERS = 8
# Places of a point that is behind the lens or not finite, and of no point; all others are larger.
# Even and odd as places on a pixel centre and between two: quads of hidden points are visited,
# empty ones are not.
HIDDEN, ABSENT = np.int32(-6), np.int32(-7)


@inner_kernel()
def project_to_pixel(x, y, z, lens):
    """Flat pixel of a point, -1 = not in view.

    Branch-free for vectorisation.
    """
    _, _, _, _, rows, cols, behind = lens
    u, v, _ = _project(x, y, z, lens)
    # Compared as floats: values beyond the integer range would wrap to another pixel. False for
    # NaN.
    ok = (
        (z > behind)
        & (z < np.inf)
        & (u >= -0.5)
        & (u < cols - 0.5)
        & (v >= -0.5)
        & (v < rows - 0.5)
    )
    # Not floor(u + 0.5), which rounds 0.49999999999999994 up.
    col = np.floor(u if ok else 0.0)
    row = np.floor(v if ok else 0.0)
    col = col if u - col < 0.5 else col + 1.0
    row = row if v - row < 0.5 else row + 1.0
    return np.int32(row * cols + col) if ok else np.int32(-1)


@kernel()
def project_points(flat, lens, pixel):
    """Write the flat pixel of each point into `pixel` (n,), -1 = not in view.

    Returns the number of points in view.
    """
    inside = 0
    for i in range(pixel.shape[0]):
        x = np.float64(flat[3 * i])
        y = np.float64(flat[3 * i + 1])
        z = np.float64(flat[3 * i + 2])
        pixel[i] = project_to_pixel(x, y, z, lens)
        inside += pixel[i] >= 0
    return inside


@kernel()
def splat_points(flat, pixel, order, image):
    """Draw the points whose `pixel` is not -1: the largest 1/z wins its pixel, ties go to the
    smaller `order`, for any sequence of points.
    """
    inverse_z, _, source = image
    for i in range(pixel.shape[0]):
        p = pixel[i]
        if p < 0:
            continue
        w = 1.0 / np.float64(flat[3 * i + 2])
        if w > inverse_z[p] or (w == inverse_z[p] and order[i] < order[source[p]]):
            inverse_z[p] = w
            source[p] = i


@kernel()
def measure_steps(flat, index, every, stride, behind, lengths):
    """Write the lengths of the steps between neighbours, mm; every `every`-th point is asked for
    its next. Returns their number.
    """
    n = 0
    for i in range(0, index.shape[0] - 1, every):
        if n == lengths.shape[0] or index[i + 1] - index[i] != stride:
            continue
        dx = np.float64(flat[3 * i + 3]) - flat[3 * i]
        dy = np.float64(flat[3 * i + 4]) - flat[3 * i + 1]
        dz = np.float64(flat[3 * i + 5]) - flat[3 * i + 2]
        lengths[n] = np.sqrt(dx * dx + dy * dy + dz * dz)
        n += flat[3 * i + 2] > behind and flat[3 * i + 5] > behind and lengths[n] < np.inf
    return n


@kernel()
def lay_out_cells(index, grid_cols, stride):
    """The point of every `stride`-th source pixel (rows, cols), -1 = none, inside a frame of empty
    cells.

    Of several points of one pixel the last is taken.
    """
    grid_cols = np.int32(grid_cols)
    # A product with a reciprocal vectorises, and is exact: the half added exceeds its error.
    rows_per_pixel = 1.0 / grid_cols
    first = left = np.int32(0x7FFFFFFF)
    last = right = np.int32(0)
    for i in range(index.shape[0]):
        at = index[i]
        col = np.int32(at - np.int32((at + 0.5) * rows_per_pixel) * grid_cols)
        first = at if at < first else first
        last = at if at > last else last
        left = col if col < left else left
        right = col if col > right else right
    top = min(first, last) // grid_cols // stride
    left = min(left, right) // stride
    cells = np.full(
        (last // grid_cols // stride - top + 3, right // stride - left + 3), -1, np.int32
    )
    flat = cells.reshape(-1)
    for i in range(index.shape[0]):
        row = np.int32((index[i] + 0.5) * rows_per_pixel)
        col = np.int32(index[i] - row * grid_cols)
        if stride > 1:
            if row % stride or col % stride:
                continue
            row //= stride
            col //= stride
        flat[np.uint32((row - top + 1) * cells.shape[1] + col - left + 1)] = i
    return cells


@kernel()
def rasterise_grid(flat, cells, lens, limits, image, counts, loose):
    """Rasterise the triangles between neighbouring cells of the source grid, row by row.

    cells (rows, cols): the point of each cell, -1 = none, inside a frame of empty ones. limits: the
    longest edge, mm^2, and the least cosine between a triangle's normal and the line of sight.
    counts (2, N_COUNTS): triangles by outcome that cover a pixel centre, those of the rim
    separately. loose (n,): becomes less than 4 for points that are corners of a triangle, drawn or
    not.

    A complete quad is split along its shorter diagonal, which follows a crease. Most quads of a
    fine source hold no pixel centre: they are found in vectorised loops, and never visited.
    """
    shape = lens[4:6]
    longest_sq, _ = limits
    # Arrays are passed one by one, and to inlined functions: numba counts references where a tuple
    # of arrays is unpacked or a call takes arrays, which costs more than a triangle.
    inverse_z, veil, source = image
    n = loose.shape[0]
    between = np.empty((2, n + 1), np.int32)  # the last for cells without a point, -1
    _find_places(flat, lens, between[0], between[1])
    between[:, n] = ABSENT
    across = np.empty((2, cells.shape[1]), np.int32)  # places of two rows of cells, in turns
    down = np.empty((2, cells.shape[1]), np.int32)
    holds_centre = np.empty(cells.shape[1], np.uint8)
    todo = np.empty(cells.shape[1], np.int32)
    for r in range(-1, cells.shape[0] - 1):
        low = (r + 1) & 1
        for c in range(cells.shape[1]):
            i = cells[r + 1, c]
            across[low, c] = between[0, i]
            down[low, c] = between[1, i]
            if i >= 0:
                loose[i] = 0
        if r < 0:
            continue
        _find_centres(across[1 - low], across[low], down[1 - low], down[low], holds_centre)
        n_todo = 0
        for c in range(cells.shape[1] - 1):  # branch-free: which quads hold one is unpredictable
            todo[n_todo] = c
            n_todo += holds_centre[c]
        n_incomplete = 0
        for t in range(n_todo):
            c = todo[t]
            # clockwise from the upper left
            a = cells[r, c]
            b = cells[r, c + 1]
            d = cells[r + 1, c + 1]
            e = cells[r + 1, c]
            n_triangles = 2
            if min(across[0, c], across[0, c + 1], across[1, c + 1], across[1, c]) > HIDDEN:
                falling = _length_sq(flat, a, d)
                rising = _length_sq(flat, b, e)
                if min(falling, rising) > longest_sq:
                    counts[0, JUMP] += 2
                    continue
                if not falling < rising:
                    a, b, d, e = e, a, b, d
            else:
                corners = (a, b, d, e)
                n_there = (a >= 0) + (b >= 0) + (d >= 0) + (e >= 0)
                hidden = _is_any_hidden(between, corners)
                if n_there < 4 and not hidden:
                    todo[n_incomplete] = c
                    n_incomplete += 1
                if n_there < 3:
                    for point in corners:
                        if point >= 0:
                            loose[point] += 1
                    continue
                if hidden:
                    counts[0, BEHIND] += 1
                    continue
                missing = 0 if a < 0 else 1 if b < 0 else 2 if d < 0 else 3
                e = a = corners[(missing + 1) & 3]
                b = corners[(missing + 2) & 3]
                d = corners[(missing + 3) & 3]
                n_triangles = 1
            i = _make_vertex(flat, between, a, lens)
            j = _make_vertex(flat, between, b, lens)
            k = _make_vertex(flat, between, d, lens)
            opposite = _make_vertex(flat, between, e, lens)
            for _ in range(n_triangles):
                _draw_triangle(i, j, k, 0, shape, limits, inverse_z, veil, source, counts)
                i, j, k = k, opposite, i
        # The part of incomplete quads that lies up to the middle of their edges.
        for t in range(n_incomplete):
            c = todo[t]
            corners = (cells[r, c], cells[r, c + 1], cells[r + 1, c + 1], cells[r + 1, c])
            for first in range(4):
                if corners[first] < 0 or corners[(first + 3) & 3] >= 0:
                    continue
                last = first  # of a run of corners
                while corners[(last + 1) & 3] >= 0:
                    last = (last + 1) & 3
                i = _make_vertex(flat, between, corners[first], lens)
                j = _make_vertex(flat, between, corners[last], lens)
                inner = _find_behind(cells, r, c, last, (last + 1) & 3)
                k = _extrapolate(j, _make_vertex(flat, between, inner, lens), longest_sq, lens)
                inner = _find_behind(cells, r, c, first, (first + 3) & 3)
                end = _extrapolate(i, _make_vertex(flat, between, inner, lens), longest_sq, lens)
                if first != last:
                    _draw_triangle(i, j, k, 1, shape, limits, inverse_z, veil, source, counts)
                _draw_triangle(i, k, end, 1, shape, limits, inverse_z, veil, source, counts)


@inner_kernel(forceinline=True)
def _make_vertex(flat, between, point, lens):
    """Point, its places among the pixel centres, pixel coordinates, 1/z, and position."""
    x = np.float64(flat[3 * point])
    y = np.float64(flat[3 * point + 1])
    z = np.float64(flat[3 * point + 2])
    u, v, w = _project(x, y, z, lens)
    return point, between[0, point], between[1, point], u, v, w, x, y, z


@inner_kernel(forceinline=True)
def _find_behind(cells, r, c, here, missing):
    """The point behind corner `here` of a quad, seen from the `missing` one; itself without one."""
    row = r + (here >> 1)
    col = c + ((here ^ (here >> 1)) & 1)
    point = cells[2 * row - r - (missing >> 1), 2 * col - c - ((missing ^ (missing >> 1)) & 1)]
    return point if point >= 0 else cells[row, col]


@inner_kernel()
def _find_places(flat, lens, across, down):
    """Places of the points among the pixel centres; vectorised."""
    _, _, _, _, rows, cols, behind = lens
    for i in range(flat.shape[0] // 3):
        x = np.float64(flat[3 * i])
        y = np.float64(flat[3 * i + 1])
        z = np.float64(flat[3 * i + 2])
        u, v, _ = _project(x, y, z, lens)
        ok = (z > behind) & (z < np.inf) & (abs(x) < np.inf) & (abs(y) < np.inf)
        at_x = _number_interval(u if ok else 0.0, cols)
        at_y = _number_interval(v if ok else 0.0, rows)
        across[i] = at_x if ok else HIDDEN
        down[i] = at_y if ok else HIDDEN


@inner_kernel()
def _find_centres(above_x, below_x, above_y, below_y, holds_centre):
    """Whether a pixel centre lies between the corners of each quad of a row, along both axes.

    True also where a corner is absent or hidden, unless all are absent; vectorised.
    """
    for c in range(holds_centre.shape[0] - 1):
        x = above_x[c]
        y = above_y[c]
        in_x = (x ^ above_x[c + 1]) | (x ^ below_x[c]) | (x ^ below_x[c + 1]) | (~x & 1)
        in_y = (y ^ above_y[c + 1]) | (y ^ below_y[c]) | (y ^ below_y[c + 1]) | (~y & 1)
        holds_centre[c] = (in_x != 0) & (in_y != 0)


@inner_kernel(forceinline=True)
def _is_any_hidden(between, corners):
    hidden = False
    for point in corners:
        hidden |= between[0, point] == HIDDEN
    return hidden


@inner_kernel()
def _number_interval(at, size):
    """Number of the place of a coordinate among the pixel centres: odd between two of them.

    Half of it, rounded up and down, are the first centre not before and the last not after it.
    Clamped as floats, to one centre beyond either border: values beyond the integer range would
    wrap.
    """
    near = at if at > -1.5 else -1.5
    near = near if near < size + 0.5 else size + 0.5
    return np.int32(np.ceil(near - SLACK)) + np.int32(np.floor(near + SLACK))


@inner_kernel()
def _length_sq(flat, i, j):
    """Squared length of an edge, in the precision of the points."""
    dx = flat[3 * i] - flat[3 * j]
    dy = flat[3 * i + 1] - flat[3 * j + 1]
    dz = flat[3 * i + 2] - flat[3 * j + 2]
    return dx * dx + dy * dy + dz * dz


@inner_kernel()
def _project(x, y, z, lens):
    """Pixel coordinates and 1/z of a position."""
    fx, fy, cx, cy, _, _, _ = lens
    w = 1.0 / z
    return fx * x * w + cx, fy * y * w + cy, w


@inner_kernel()
def _extrapolate(border, inner, longest_sq, lens):
    """The vertex half a step beyond a border point, on the line from the one behind it; the border
    point itself where those two are too far apart.
    """
    _, _, _, _, rows, cols, behind = lens
    point, _, _, _, _, _, x, y, z = border
    _, _, _, _, _, _, inner_x, inner_y, inner_z = inner
    dx = x - inner_x
    dy = y - inner_y
    dz = z - inner_z
    length_sq = dx * dx + dy * dy + dz * dz
    if not (inner_z > behind and length_sq <= longest_sq and z + 0.5 * dz > behind):
        return border
    x = x + 0.5 * dx
    y = y + 0.5 * dy
    z = z + 0.5 * dz
    u, v, w = _project(x, y, z, lens)
    return point, _number_interval(u, cols), _number_interval(v, rows), u, v, w, x, y, z


@inner_kernel()
def _classify_triangle(i, j, k, limits):
    """Outcome by the lengths of the edges and the angle between normal and line of sight."""
    longest_sq, least_cos = limits
    _, _, _, _, _, _, x, y, z = i
    _, _, _, _, _, _, bx, by, bz = j
    _, _, _, _, _, _, cx, cy, cz = k
    bx -= x
    by -= y
    bz -= z
    cx -= x
    cy -= y
    cz -= z
    dx = cx - bx
    dy = cy - by
    dz = cz - bz
    longest = max(
        bx * bx + by * by + bz * bz, cx * cx + cy * cy + cz * cz, dx * dx + dy * dy + dz * dz
    )
    if not longest <= longest_sq:
        return JUMP
    nx = by * cz - bz * cy
    ny = bz * cx - bx * cz
    nz = bx * cy - by * cx
    mx = 3.0 * x + bx + cx  # three times the middle
    my = 3.0 * y + by + cy
    mz = 3.0 * z + bz + cz
    along = nx * mx + ny * my + nz * mz
    limit_sq = least_cos * least_cos * (nx * nx + ny * ny + nz * nz) * (mx * mx + my * my + mz * mz)
    if along == 0.0 or not along * along >= limit_sq:
        return GRAZING
    return DRAWN if along > 0.0 else FLIPPED


@inner_kernel(forceinline=True)
def _draw_triangle(i, j, k, rim, shape, limits, inverse_z, veil, source, counts):
    """Draw one triangle in the pixels whose centres it covers: 1/z is linear on screen, the largest
    wins.

    It is counted if it covers one, or if its box is large.
    """
    rows, cols = shape
    point_a, across_a, down_a, xa, ya, near_a, _, _, _ = i
    point_b, across_b, down_b, xb, yb, near_b, _, _, _ = j
    point_c, across_c, down_c, xc, yc, near_c, _, _, _ = k
    left = max((min(across_a, across_b, across_c) + 1) >> 1, 0)
    right = min(max(across_a, across_b, across_c) >> 1, cols - 1)
    top = max((min(down_a, down_b, down_c) + 1) >> 1, 0)
    bottom = min(max(down_a, down_b, down_c) >> 1, rows - 1)
    if left > right or top > bottom:
        return
    area = (xb - xa) * (yc - ya) - (xc - xa) * (yb - ya)
    if area == 0.0:
        return
    scale = 1.0 / area
    outcome = JUMP
    large = (right - left + 1) * (bottom - top + 1) > LARGE_PX
    if large:
        outcome = _classify_triangle(i, j, k, limits)
        if counts[rim, PIXELS_SPENT] > MAX_LAYERS * rows * cols:
            outcome = OVERFULL
        counts[rim, outcome] += 1
        if outcome < GRAZING:
            return
    counted = large
    slopes = ((yb - yc) * scale, (yc - ya) * scale, (ya - yb) * scale)
    for y in range(top, bottom + 1):
        begin = left
        end = right
        if large:
            wa = ((xb - left) * (yc - y) - (xc - left) * (yb - y)) * scale
            wb = ((xc - left) * (ya - y) - (xa - left) * (yc - y)) * scale
            begin, end = _clip_row((wa, wb, 1.0 - wa - wb), slopes, left, right)
            counts[rim, PIXELS_SPENT] += max(end - begin + 1, 0) + 1
        for x in range(begin, end + 1):
            wa = ((xb - x) * (yc - y) - (xc - x) * (yb - y)) * scale
            wb = ((xc - x) * (ya - y) - (xa - x) * (yc - y)) * scale
            wc = 1.0 - wa - wb
            if min(wa, wb, wc) < -SLACK:
                continue
            if not counted:
                outcome = _classify_triangle(i, j, k, limits)
                counted = True
                counts[rim, outcome] += 1
            near = wa * near_a + wb * near_b + wc * near_c
            p = y * cols + x
            if outcome == GRAZING:
                veil[p] = max(veil[p], near)
            elif outcome > GRAZING and near > inverse_z[p]:
                inverse_z[p] = near
                # The corner with the largest weight is nearest on screen.
                nearest = point_b if wb > wa else point_a
                source[p] = point_c if wc > max(wa, wb) else nearest


@inner_kernel()
def _clip_row(weights, slopes, first, last):
    """Column range of a row in which no weight is negative, one pixel wider on either side.

    `weights` are those at column `first`, `slopes` their change per column.
    """
    low = 0.0
    high = np.float64(last - first)
    for k in range(3):
        if slopes[k] != 0.0:
            zero = -weights[k] / slopes[k]
            if slopes[k] > 0.0:
                low = max(low, zero - 1.0)
            else:
                high = min(high, zero + 1.0)
    if not low <= high:
        return first, first - 1
    return first + np.int64(low), first + np.int64(np.ceil(high))


@kernel()
def mark_hidden_points(flat, depth, lens, tolerance, pixel):
    """Set to -1 the pixel of every point that the image does not show there.

    Returns the number of hidden points.

    A point is shown if it lies at most `tolerance` behind the depth of its pixel or, on a slope, of
    one of the eight around it. Where nothing is drawn it was cut away, not hidden.
    """
    _, _, _, _, rows, cols, _ = lens
    hidden = 0
    for i in range(pixel.shape[0]):
        p = pixel[i]
        if p < 0:
            continue
        limit = flat[3 * i + 2] - tolerance
        shown = depth[p] >= limit
        drawn = shown or depth[p] < limit
        if not shown and drawn:
            row = p // cols
            col = p % cols
            for r in range(max(row - 1, 0), min(row + 2, rows)):
                for c in range(max(col - 1, 0), min(col + 2, cols)):
                    shown |= depth[r * cols + c] >= limit
        if not shown:
            hidden += drawn
            pixel[i] = -1
    return hidden


@inner_kernel(forceinline=True)
def sample_rest_surface(x, y, rest):
    """Rest surface at (x, y): bilinear, constant beyond the border."""
    x0, y0, per_mm, z, nx, ny = rest
    return sample_height(z, nx, ny, (x - x0) * per_mm, (y - y0) * per_mm)[0]


@kernel()
def mark_contact_points(flat, pixel, rest, contact):
    """Mark in `contact` the pixels of the points that reach the membrane."""
    for i in range(pixel.shape[0]):
        p = pixel[i]
        if p < 0 or contact[p]:
            continue
        x = np.float64(flat[3 * i])
        y = np.float64(flat[3 * i + 1])
        z = np.float64(flat[3 * i + 2])
        if z <= sample_rest_surface(x, y, rest):
            contact[p] = True


@kernel()
def resolve_depth_and_contact(image, veiled, tolerance, rays, rest, depth, contact):
    """Depth of every drawn pixel from its 1/z, and whether that point reaches the membrane.

    Pixels more than `tolerance` behind a veil, and depths beyond the float32 range (a rim
    extrapolated from points close to the lens), are cleared. Returns the numbers of pixels drawn
    and of pixels hidden by a veil.
    """
    inverse_z, veil, source = image
    ray_x, ray_y = rays
    drawn = 0
    hidden = 0
    cols = ray_x.shape[0]
    for row in range(ray_y.shape[0]):
        for col in range(cols):
            p = row * cols + col
            there = inverse_z[p] > MIN_INVERSE_Z
            # 1 / 0 is infinitely far
            if veiled and there and 1.0 / inverse_z[p] - 1.0 / veil[p] > tolerance:
                there = False
                hidden += 1
            if not there:
                depth[p] = np.nan
                contact[p] = False
                source[p] = -1
                continue
            z = 1.0 / inverse_z[p]
            depth[p] = z
            contact[p] = z <= sample_rest_surface(z * ray_x[col], z * ray_y[row], rest)
            drawn += 1
    return drawn, hidden
