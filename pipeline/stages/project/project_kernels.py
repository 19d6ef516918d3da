# pyright: basic
"""Compiled loops of the project stage: where each point falls, the z-buffer, and what the drawn image comes to.

Pixel centres are at integer coordinates, so a pixel owns the half-open square from -0.5 up to, not including, +0.5.
`lens` is (fx, fy, cx, cy) in px, `shape` (rows, cols) of the target image, which is written flat.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

LEAST_INVERSE_Z = 1.0 / float(np.finfo(np.float32).max)  # 1/mm


@njit(cache=True, error_model="numpy")
def to_pixels(flat, lens, shape, z_min, pixel):
    """Write into `pixel` (n,) the pixel that each point of `flat` (3 n) falls on, -1 = not in view.

    Returns how many are in view. No branches, so that it runs on vectors of points.
    """
    fx, fy, cx, cy = lens
    rows, cols = shape
    inside = 0
    for i in range(pixel.shape[0]):
        x, y, z = np.float64(flat[3 * i]), np.float64(flat[3 * i + 1]), np.float64(flat[3 * i + 2])
        w = 1.0 / z
        u, v = fx * x * w + cx, fy * y * w + cy
        # On floats, before any cast: what an integer cannot hold would come out as some other pixel. False for NaN.
        ok = (z > z_min) & (z < np.inf) & (u >= -0.5) & (u < cols - 0.5) & (v >= -0.5) & (v < rows - 0.5)
        u, v = (u if ok else 0.0), (v if ok else 0.0)
        # Not floor(u + 0.5), which would round 0.49999999999999994 up.
        col, row = np.floor(u), np.floor(v)
        col, row = (col if u - col < 0.5 else col + 1.0), (row if v - row < 0.5 else row + 1.0)
        pixel[i] = np.int32(row * cols + col) if ok else np.int32(-1)
        inside += np.int64(ok)
    return inside


@njit(cache=True)
def nearest(points, order, pixel, depth, source):
    """The z-buffer: the smallest z wins its pixel, equal ones go to the smaller `order`, whatever the sequence.

    `depth` comes in as NaN and `source` as -1; returns how many pixels were won.
    """
    won = 0
    for i in range(pixel.shape[0]):
        p = pixel[i]
        if p < 0:
            continue
        z = points[i, 2]
        if not z >= depth[p]:  # true for the NaN of a pixel that nobody has won yet
            won += source[p] < 0
            depth[p] = z
            source[p] = i
        elif z == depth[p] and order[i] < order[source[p]]:
            source[p] = i
    return won


@njit(cache=True, error_model="numpy")
def splat(points, wanted, order, pixel, inverse_z, source):
    """Points drawn among triangles: as `nearest`, on 1/z and for the wanted points only."""
    for i in range(pixel.shape[0]):
        p = pixel[i]
        if p < 0 or not wanted[i]:
            continue
        w = 1.0 / np.float64(points[i, 2])
        if w > inverse_z[p] or (w == inverse_z[p] and order[i] < order[source[p]]):
            inverse_z[p] = w
            source[p] = i


@njit(cache=True)
def hide(points, depth, shape, tolerance, pixel):
    """Set to -1 the pixel of every point that is not part of what the image shows there; returns (undrawn, hidden).

    A point is part of it when it lies at most `tolerance` behind the depth drawn in its pixel or, on a slope, in one
    of the eight around it.
    """
    rows, cols = shape
    undrawn, hidden = 0, 0
    for i in range(pixel.shape[0]):
        p = pixel[i]
        if p < 0:
            continue
        limit = points[i, 2] - tolerance
        if depth[p] >= limit:
            continue
        if math.isnan(depth[p]):
            undrawn += 1
            pixel[i] = -1
        elif not _seen_around(depth, p // cols, p % cols, rows, cols, limit):
            hidden += 1
            pixel[i] = -1
    return undrawn, hidden


@njit(cache=True)
def _seen_around(depth, row, col, rows, cols, limit):
    for r in range(max(row - 1, 0), min(row + 2, rows)):
        for c in range(max(col - 1, 0), min(col + 2, cols)):
            if depth[r * cols + c] >= limit:
                return True
    return False


@njit(cache=True, error_model="numpy")
def height(x, y, x0, y0, per_mm, z):
    """The rest surface z (ny, nx) at (x, y): bilinear, level beyond the border."""
    ny, nx = z.shape
    u = min(max((x - x0) * per_mm, 0.0), nx - 1.0)
    v = min(max((y - y0) * per_mm, 0.0), ny - 1.0)
    i, j = min(int(u), nx - 2), min(int(v), ny - 2)
    a, b = u - i, v - j
    return (z[j, i] * (1 - a) + z[j, i + 1] * a) * (1 - b) + (z[j + 1, i] * (1 - a) + z[j + 1, i + 1] * a) * b


@njit(cache=True)
def touching_points(points, pixel, x0, y0, per_mm, surface, contact):
    """Mark in `contact` the pixels of the points that reach the membrane."""
    for i in range(pixel.shape[0]):
        p = pixel[i]
        if p < 0 or contact[p]:
            continue
        x, y, z = np.float64(points[i, 0]), np.float64(points[i, 1]), np.float64(points[i, 2])
        if z <= height(x, y, x0, y0, per_mm, surface):
            contact[p] = True


@njit(cache=True, error_model="numpy")
def touching_pixels(inverse_z, ray_x, ray_y, x0, y0, per_mm, surface, source, depth, contact):
    """Depth of every drawn pixel from its 1/z, and whether what it sees reaches the membrane; returns how many drew.

    What lies beyond any length that float32 holds (a rim drawn on from points almost there) is taken back.
    """
    seen = 0
    cols = ray_x.shape[0]
    for row in range(ray_y.shape[0]):
        for col in range(cols):
            p = row * cols + col
            w = inverse_z[p]
            if not w > LEAST_INVERSE_Z:
                depth[p] = np.nan
                contact[p] = False
                source[p] = -1
                continue
            z = 1.0 / w
            depth[p] = z
            contact[p] = z <= height(z * ray_x[col], z * ray_y[row], x0, y0, per_mm, surface)
            seen += 1
    return seen


@njit(cache=True)
def push_in(depth, contact, rest, indentation):
    """Write rest - depth where in contact, else 0; returns (pixels in contact, deepest)."""
    n, deepest = 0, np.float32(0.0)
    for p in range(depth.shape[0]):
        pushed = np.float32(max(rest[p] - depth[p], 0.0)) if contact[p] else np.float32(0.0)
        indentation[p] = pushed
        deepest = max(deepest, pushed)
        n += contact[p]
    return n, deepest


@njit(cache=True, error_model="numpy")
def fill_window(x_px, y_px, known):
    """Set in `known` (rows, cols) the pixels whose centre lies in the convex polygon of corners in turn, row by row."""
    n = x_px.shape[0]
    doubled = 0.0
    for k in range(n):
        m = (k + 1) % n
        doubled += x_px[k] * y_px[m] - x_px[m] * y_px[k]
    rows, cols = known.shape
    for r in range(rows):
        first, last = 0.0, cols - 1.0
        for k in range(n):
            m = (k + 1) % n
            # Inside is where a * col + b >= 0, for every edge.
            a, b = y_px[k] - y_px[m], (x_px[m] - x_px[k]) * (r - y_px[k]) + (y_px[m] - y_px[k]) * x_px[k]
            if doubled < 0.0:
                a, b = -a, -b
            if a > 0.0:
                first = max(first, math.ceil(-b / a) if -b / a > 0.0 else 0.0)
            elif a < 0.0:
                last = min(last, math.floor(b / -a) if b / -a < cols else last)
            elif not b >= 0.0:
                last = -1.0
        if first <= last:
            known[r, int(first) : int(last) + 1] = True
