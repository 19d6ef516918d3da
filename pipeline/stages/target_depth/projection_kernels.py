# pyright: basic
"""Compiled loops of the projection: pixel of each point, z-buffer, depth and contact of the drawn
image.

Pixel centres are at integer coordinates; a pixel owns the half-open square from -0.5 to +0.5.
Points are flat (3 n) float32, images flat in row-major order. Related arguments are plain tuples
(numba's cache does not survive the renaming of named tuples):

    lens   fx, fy, cx, cy, rows, cols, and the depth up to which a point is behind the lens
    rest   the target's membrane at rest: x0, y0, 1 / step, z (ny, nx)
    image  drawing buffers, the largest 1/z wins its pixel: 1/z, 0 = nothing; 1/z of the veil
           (omitted triangles, which still hide what lies behind them); the point drawn, -1 = none
"""

from __future__ import annotations

import numpy as np

from pipeline.core.cached_kernels import inner_kernel, kernel
from pipeline.core.geometry.membrane_kernels import sample_height

MIN_INVERSE_Z = 1.0 / float(np.finfo(np.float32).max)  # 1/mm


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
def fill_zbuffer(flat, order, pixel, depth, source):
    """Fill the z-buffer: the smallest z wins its pixel, ties go to the smaller `order`, for any
    sequence of points.

    `depth` is initially NaN and `source` -1; returns the number of pixels drawn.
    """
    won = 0
    for i in range(pixel.shape[0]):
        p = pixel[i]
        if p < 0:
            continue
        z = flat[3 * i + 2]
        if not z >= depth[p]:  # also true for the NaN of an empty pixel
            won += source[p] < 0
            depth[p] = z
            source[p] = i
        elif z == depth[p] and order[i] < order[source[p]]:
            source[p] = i
    return won


@kernel()
def splat_points(flat, wanted, order, lens, image):
    """Draw selected points among triangles: as `fill_zbuffer`, on 1/z.

    Returns the number of points in view.
    """
    inverse_z, _, source = image
    inside = 0
    for i in range(wanted.shape[0]):
        if not wanted[i]:
            continue
        x = np.float64(flat[3 * i])
        y = np.float64(flat[3 * i + 1])
        z = np.float64(flat[3 * i + 2])
        _, _, w, p = project_to_pixel(x, y, z, lens)
        inside += p >= 0
        if p >= 0 and (w > inverse_z[p] or (w == inverse_z[p] and order[i] < order[source[p]])):
            inverse_z[p] = w
            source[p] = i
    return inside


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
