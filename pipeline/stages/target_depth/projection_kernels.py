# pyright: basic
"""Compiled loops of the project stage: where each point falls, the z-buffer, and what the drawn image comes to.

Pixel centres are at integer coordinates, so a pixel owns the half-open square from -0.5 up to, not including, +0.5.
Points are flat (3 n) float32, images flat in rows. What belongs together comes as plain tuples, which are taken apart
where they are used (numba's cache would not survive the renaming of a named one):

    lens   fx, fy, cx, cy, rows, cols, and the depth up to which a point counts as behind the lens
    rest   the target's membrane: x0, y0, 1 / step, z (ny, nx)
    image  what is drawn into, the largest 1/z winning its pixel: 1/z, 0 = nothing there; 1/z of the veil, which is what
           is left out and hides what lies behind it all the same; the point drawn there, -1 = none
"""

from __future__ import annotations

import numpy as np

from pipeline.base.cached_kernels import inner_kernel, kernel

MIN_INVERSE_Z = 1.0 / float(np.finfo(np.float32).max)  # 1/mm


@inner_kernel()
def project_to_pixel(x, y, z, lens):
    """Where a point is seen (u, v), px, its 1/z, and the pixel that it falls on, -1 = not in view.

    No branches, so that it runs on vectors of points.
    """
    fx, fy, cx, cy, rows, cols, behind = lens
    w = 1.0 / z
    u, v = fx * x * w + cx, fy * y * w + cy
    # On floats, before any cast: what an integer cannot hold would come out as some other pixel. False for NaN.
    ok = (z > behind) & (z < np.inf) & (u >= -0.5) & (u < cols - 0.5) & (v >= -0.5) & (v < rows - 0.5)
    # Not floor(u + 0.5), which would round 0.49999999999999994 up.
    col, row = np.floor(u if ok else 0.0), np.floor(v if ok else 0.0)
    col, row = (col if u - col < 0.5 else col + 1.0), (row if v - row < 0.5 else row + 1.0)
    return u, v, w, np.int32(row * cols + col) if ok else np.int32(-1)


@kernel()
def project_points(flat, lens, pixel):
    """Write into `pixel` (n,) the pixel that each point falls on, -1 = not in view; returns how many are in view."""
    inside = 0
    for i in range(pixel.shape[0]):
        x, y, z = np.float64(flat[3 * i]), np.float64(flat[3 * i + 1]), np.float64(flat[3 * i + 2])
        _, _, _, pixel[i] = project_to_pixel(x, y, z, lens)
        inside += pixel[i] >= 0
    return inside


@kernel()
def fill_zbuffer(flat, order, pixel, depth, source):
    """The z-buffer: the smallest z wins its pixel, equal ones go to the smaller `order`, whatever the sequence.

    `depth` comes in as NaN and `source` as -1; returns how many pixels were won.
    """
    won = 0
    for i in range(pixel.shape[0]):
        p = pixel[i]
        if p < 0:
            continue
        z = flat[3 * i + 2]
        if not z >= depth[p]:  # true for the NaN of a pixel that nobody has won yet
            won += source[p] < 0
            depth[p] = z
            source[p] = i
        elif z == depth[p] and order[i] < order[source[p]]:
            source[p] = i
    return won


@kernel()
def splat_points(flat, wanted, order, lens, image):
    """Points drawn among triangles: as `nearest`, on 1/z and for the wanted points only; how many are in view."""
    inverse_z, _, source = image
    inside = 0
    for i in range(wanted.shape[0]):
        if not wanted[i]:
            continue
        x, y, z = np.float64(flat[3 * i]), np.float64(flat[3 * i + 1]), np.float64(flat[3 * i + 2])
        _, _, w, p = project_to_pixel(x, y, z, lens)
        inside += p >= 0
        if p >= 0 and (w > inverse_z[p] or (w == inverse_z[p] and order[i] < order[source[p]])):
            inverse_z[p] = w
            source[p] = i
    return inside


@kernel()
def mark_hidden_points(flat, depth, lens, tolerance, pixel):
    """Set to -1 the pixel of every point that is not part of what the image shows there; returns how many are hidden.

    A point is part of it when it lies at most `tolerance` behind the depth drawn in its pixel or, on a slope, in one
    of the eight around it; where nothing is drawn it is cut away, not hidden.
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
            row, col = p // cols, p % cols
            for r in range(max(row - 1, 0), min(row + 2, rows)):
                for c in range(max(col - 1, 0), min(col + 2, cols)):
                    shown |= depth[r * cols + c] >= limit
        if not shown:
            hidden += drawn
            pixel[i] = -1
    return hidden


@inner_kernel()
def sample_rest_surface(x, y, rest):
    """The rest surface at (x, y): bilinear, level beyond the border."""
    x0, y0, per_mm, z = rest
    ny, nx = z.shape
    u = min(max((x - x0) * per_mm, 0.0), nx - 1.0)
    v = min(max((y - y0) * per_mm, 0.0), ny - 1.0)
    i, j = min(int(u), nx - 2), min(int(v), ny - 2)
    a, b = u - i, v - j
    return (z[j, i] * (1 - a) + z[j, i + 1] * a) * (1 - b) + (z[j + 1, i] * (1 - a) + z[j + 1, i + 1] * a) * b


@kernel()
def mark_contact_points(flat, pixel, rest, contact):
    """Mark in `contact` the pixels of the points that reach the membrane."""
    for i in range(pixel.shape[0]):
        p = pixel[i]
        if p < 0 or contact[p]:
            continue
        x, y, z = np.float64(flat[3 * i]), np.float64(flat[3 * i + 1]), np.float64(flat[3 * i + 2])
        if z <= sample_rest_surface(x, y, rest):
            contact[p] = True


@kernel()
def resolve_depth_and_contact(image, veiled, tolerance, rays, rest, depth, contact):
    """Depth of every drawn pixel from its 1/z, and whether what it sees reaches the membrane.

    Taken back is what lies more than `tolerance` behind a veil, if there is any, and what lies beyond any length that
    float32 holds (a rim drawn on from points almost there). Returns how many pixels are drawn, and how many a veil
    hides.
    """
    inverse_z, veil, source = image
    ray_x, ray_y = rays
    drawn, hidden = 0, 0
    cols = ray_x.shape[0]
    for row in range(ray_y.shape[0]):
        for col in range(cols):
            p = row * cols + col
            there = inverse_z[p] > MIN_INVERSE_Z
            if veiled and there and 1.0 / inverse_z[p] - 1.0 / veil[p] > tolerance:  # 1 / 0 is farther than anything
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
