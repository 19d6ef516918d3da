# pyright: basic
"""Compiled loops of the projection: pixel of each point, triangles of the source grid, depth and
contact of the drawn image.

Pixel centres are at integer coordinates; a pixel owns the half-open square from -0.5 to +0.5.
Points are flat (3 n) float32, images flat in row-major order. Related arguments are plain tuples
(numba's cache does not survive the renaming of named tuples):

    lens   fx, fy, cx, cy, rows, cols, and the depth up to which a point is behind the lens
    rest   the target's membrane at rest: x0, y0, 1 / step, z (ny, nx)
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


@inner_kernel()
def project_to_pixel(x, y, z, lens):
    """Pixel coordinates (u, v), 1/z and flat pixel (-1 = not in view) of a point.

    Branch-free for vectorisation.
    """
    fx, fy, cx, cy, rows, cols, behind = lens
    w = 1.0 / z
    u = fx * x * w + cx
    v = fy * y * w + cy
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
    return u, v, w, np.int32(row * cols + col) if ok else np.int32(-1)


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
        _, _, _, pixel[i] = project_to_pixel(x, y, z, lens)
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
def rasterise_grid(flat, cells, lens, limits, image, counts, linked):
    """Rasterise the triangles between neighbouring cells of the source grid, row by row.

    cells (rows, cols): the point of each cell, -1 = none, inside a frame of empty ones. limits: the
    longest edge, mm^2, and the least cosine between a triangle's normal and the line of sight.
    counts (2, N_COUNTS): triangles by outcome that cover a pixel centre, those of the rim
    separately. linked (n,): becomes True for points that are corners of a triangle, drawn or not.

    A complete quad is split along its shorter diagonal, which follows a crease.
    """
    _, _, _, _, rows, cols, behind = lens
    longest_sq, _ = limits
    # Arrays are passed one by one: a tuple of arrays is unpacked with reference counting.
    inverse_z, veil, source = image
    n = linked.shape[0]
    vertices = np.empty(
        (n + 2, 7)
    )  # x, y, z, pixel coordinates, 1/z, point; the last two: of a rim
    is_visible = np.empty(n, np.bool_)
    between = np.empty((n, 2), np.int32)
    for i in range(n):
        x = np.float64(flat[3 * i])
        y = np.float64(flat[3 * i + 1])
        z = np.float64(flat[3 * i + 2])
        is_visible[i] = (z > behind) & (z < np.inf) & (abs(x) < np.inf) & (abs(y) < np.inf)
        _write_vertex(vertices, i, x, y, z, i, lens)
        between[i, 0] = _number_interval(vertices[i, 3], cols)
        between[i, 1] = _number_interval(vertices[i, 4], rows)
    for r in range(cells.shape[0] - 1):
        for c in range(cells.shape[1] - 1):
            # clockwise from the upper left
            a = cells[r, c]
            b = cells[r, c + 1]
            d = cells[r + 1, c + 1]
            e = cells[r + 1, c]
            n_there = (a >= 0) + (b >= 0) + (d >= 0) + (e >= 0)
            if n_there < 3:
                continue
            corners = (a, b, d, e)
            missing = 0 if a < 0 else 1 if b < 0 else 2 if d < 0 else 3
            all_visible = True
            for point in corners:
                if point >= 0:
                    linked[point] = True
                    all_visible &= is_visible[point]
            if not all_visible:
                counts[0, BEHIND] += 1
            elif n_there < 4:
                _draw_quad_less(
                    vertices, corners, missing, lens, limits, inverse_z, veil, source, counts
                )
            elif _may_cover(between, a, b, d, e, 0) and _may_cover(between, a, b, d, e, 1):
                falling = _length_sq(flat, a, d)
                rising = _length_sq(flat, b, e)
                if min(falling, rising) > longest_sq:
                    counts[0, JUMP] += 2
                    continue
                first = 3 if falling < rising else 2
                _draw_quad_less(
                    vertices, corners, first, lens, limits, inverse_z, veil, source, counts
                )
                _draw_quad_less(
                    vertices, corners, first - 2, lens, limits, inverse_z, veil, source, counts
                )
        for c in range(cells.shape[1] - 1):
            n_there = (cells[r, c] >= 0) + (cells[r, c + 1] >= 0)
            n_there += (cells[r + 1, c] >= 0) + (cells[r + 1, c + 1] >= 0)
            if 0 < n_there < 4:
                _draw_rim(
                    vertices, is_visible, cells, r, c, lens, limits, inverse_z, veil, source, counts
                )


@inner_kernel()
def _number_interval(at, size):
    """Number of the place of a coordinate among the pixel centres: odd between two of them."""
    near = min(max(at, -1.5), size + 0.5)
    return np.int32(np.ceil(near - SLACK)) + np.int32(np.floor(near + SLACK))


@inner_kernel()
def _may_cover(between, a, b, d, e, axis):
    """Whether a pixel centre lies between a quad's corners along an axis: it does not for most
    quads of a fine source.
    """
    place = between[a, axis]
    same = place == between[b, axis] and place == between[d, axis] and place == between[e, axis]
    return not same or place & 1 == 0


@inner_kernel()
def _write_vertex(vertices, to, x, y, z, point, lens):
    fx, fy, cx, cy, _, _, _ = lens
    w = 1.0 / z
    vertices[to, 0] = x
    vertices[to, 1] = y
    vertices[to, 2] = z
    vertices[to, 3] = fx * x * w + cx
    vertices[to, 4] = fy * y * w + cy
    vertices[to, 5] = w
    vertices[to, 6] = point


@inner_kernel()
def _length_sq(flat, i, j):
    """Squared length of an edge, in the precision of the points."""
    dx = flat[3 * i] - flat[3 * j]
    dy = flat[3 * i + 1] - flat[3 * j + 1]
    dz = flat[3 * i + 2] - flat[3 * j + 2]
    return dx * dx + dy * dy + dz * dz


@inner_kernel()
def _bracket_centres(low, high, size):
    """First and last pixel centre from `low` to `high`, at most one beyond either border.

    Clamped as floats: values beyond the integer range would wrap.
    """
    low = min(max(low, -1.5), size + 0.5)
    high = min(max(high, -1.5), size + 0.5)
    return np.int64(np.ceil(low - SLACK)), np.int64(np.floor(high + SLACK))


@inner_kernel()
def _draw_quad_less(vertices, corners, missing, lens, limits, inverse_z, veil, source, counts):
    """Draw the triangle of a quad's corners but one."""
    i = corners[(missing + 1) & 3]
    j = corners[(missing + 2) & 3]
    k = corners[(missing + 3) & 3]
    _draw_triangle(vertices, (i, j, k), 0, lens, limits, inverse_z, veil, source, counts)


@inner_kernel()
def _draw_rim(vertices, is_visible, cells, r, c, lens, limits, inverse_z, veil, source, counts):
    """Draw the part of an incomplete quad that lies up to the middle of its edges."""
    corners = (cells[r, c], cells[r, c + 1], cells[r + 1, c + 1], cells[r + 1, c])
    n = np.int32(vertices.shape[0] - 2)
    end = np.int32(n + 1)
    for point in corners:
        if point >= 0 and not is_visible[point]:
            return
    for first in range(4):
        if corners[first] < 0 or corners[(first + 3) & 3] >= 0:
            continue
        last = first  # of a run of corners
        while corners[(last + 1) & 3] >= 0:
            last = (last + 1) & 3
        _extend(vertices, n, cells, r, c, last, last + 1, lens, limits)
        _extend(vertices, end, cells, r, c, first, first + 3, lens, limits)
        if first != last:
            corners_of_run = (corners[first], corners[last], n)
            _draw_triangle(
                vertices, corners_of_run, 1, lens, limits, inverse_z, veil, source, counts
            )
        at_end = (corners[first], n, end)
        _draw_triangle(vertices, at_end, 1, lens, limits, inverse_z, veil, source, counts)


@inner_kernel()
def _extend(vertices, to, cells, r, c, here, missing, lens, limits):
    """Write a vertex half a step from corner `here` of a quad toward the `missing` one: on the line
    from the point behind, or the corner itself without one.
    """
    longest_sq, _ = limits
    behind = lens[6]
    row = r + (here >> 1)
    col = c + ((here ^ (here >> 1)) & 1)
    missing &= 3
    i = cells[row, col]
    j = cells[2 * row - r - (missing >> 1), 2 * col - c - ((missing ^ (missing >> 1)) & 1)]
    x = vertices[i, 0]
    y = vertices[i, 1]
    z = vertices[i, 2]
    if j >= 0 and vertices[j, 2] > behind:
        dx = x - vertices[j, 0]
        dy = y - vertices[j, 1]
        dz = z - vertices[j, 2]
        if dx * dx + dy * dy + dz * dz <= longest_sq and z + 0.5 * dz > behind:
            x = x + 0.5 * dx
            y = y + 0.5 * dy
            z = z + 0.5 * dz
    _write_vertex(vertices, to, x, y, z, i, lens)


@inner_kernel()
def _classify_triangle(vertices, corners, limits):
    """Outcome by the lengths of the edges and the angle between normal and line of sight."""
    longest_sq, least_cos = limits
    i, j, k = corners
    x = vertices[i, 0]
    y = vertices[i, 1]
    z = vertices[i, 2]
    bx = vertices[j, 0] - x
    by = vertices[j, 1] - y
    bz = vertices[j, 2] - z
    cx = vertices[k, 0] - x
    cy = vertices[k, 1] - y
    cz = vertices[k, 2] - z
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
    mx = x + (bx + cx) / 3.0
    my = y + (by + cy) / 3.0
    mz = z + (bz + cz) / 3.0
    along = nx * mx + ny * my + nz * mz
    limit_sq = least_cos * least_cos * (nx * nx + ny * ny + nz * nz) * (mx * mx + my * my + mz * mz)
    if along == 0.0 or not along * along >= limit_sq:
        return GRAZING
    return DRAWN if along > 0.0 else FLIPPED


@inner_kernel()
def _draw_triangle(vertices, corners, rim, lens, limits, inverse_z, veil, source, counts):
    """Draw one triangle in the pixels whose centres it covers: 1/z is linear on screen, the largest
    wins.

    It is counted if it covers one, or if its box is large.
    """
    _, _, _, _, rows, cols, _ = lens
    i, j, k = corners
    xa = vertices[i, 3]
    ya = vertices[i, 4]
    xb = vertices[j, 3]
    yb = vertices[j, 4]
    xc = vertices[k, 3]
    yc = vertices[k, 4]
    left, right = _bracket_centres(min(xa, xb, xc), max(xa, xb, xc), cols)
    top, bottom = _bracket_centres(min(ya, yb, yc), max(ya, yb, yc), rows)
    left = max(left, 0)
    right = min(right, cols - 1)
    top = max(top, 0)
    bottom = min(bottom, rows - 1)
    area = (xb - xa) * (yc - ya) - (xc - xa) * (yb - ya)
    if left > right or top > bottom or area == 0.0:
        return
    scale = 1.0 / area
    outcome = JUMP
    large = (right - left + 1) * (bottom - top + 1) > LARGE_PX
    if large:
        outcome = _classify_triangle(vertices, corners, limits)
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
            if wa < -SLACK or wb < -SLACK or wc < -SLACK:
                continue
            if not counted:
                outcome = _classify_triangle(vertices, corners, limits)
                counted = True
                counts[rim, outcome] += 1
            near = wa * vertices[i, 5] + wb * vertices[j, 5] + wc * vertices[k, 5]
            p = y * cols + x
            if outcome == GRAZING:
                veil[p] = max(veil[p], near)
            elif outcome > GRAZING and near > inverse_z[p]:
                inverse_z[p] = near
                # The corner with the largest weight is nearest on screen.
                nearest = j if wb > wa else i
                source[p] = np.int32(vertices[k if wc > max(wa, wb) else nearest, 6])


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


@inner_kernel()
def sample_rest_surface(x, y, rest):
    """Rest surface at (x, y): bilinear, constant beyond the border."""
    x0, y0, per_mm, z = rest
    ny, nx = z.shape
    return sample_height(z.reshape(-1), nx, ny, (x - x0) * per_mm, (y - y0) * per_mm)[0]


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
