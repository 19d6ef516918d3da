# pyright: basic
"""Compiled loops of the project stage: the point splat and the triangle rasteriser.

Both work on 1/z, which is linear in screen space, and keep the largest: the point nearest to the camera.
Pixel centres are at integer coordinates, so a pixel owns the half-open square from -0.5 up to, not including, +0.5.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

SLACK = 1e-9  # barycentric and px: neighbours share the pixels on their common edge, so that no crack opens
JUMP, GRAZING, BEHIND, FLIPPED, KEPT = 0, 1, 2, 3, 4  # what becomes of a triangle; from FLIPPED on it is drawn


@njit(cache=True)
def to_screen(points, fx, fy, cx, cy, rows, cols, z_min):
    """(x_px, y_px, 1/z) (n, 3) of points, 1/z = 0 behind the lens, and the pixel (n,) of each, -1 = not in view."""
    n = points.shape[0]
    screen = np.empty((n, 3), dtype=np.float64)
    pixel = np.full(n, -1, dtype=np.int32)
    for i in range(n):
        x, y, z = np.float64(points[i, 0]), np.float64(points[i, 1]), np.float64(points[i, 2])
        if not (z > z_min and math.isfinite(z) and math.isfinite(x) and math.isfinite(y)):
            screen[i, 0], screen[i, 1], screen[i, 2] = 0.0, 0.0, 0.0
            continue
        w = 1.0 / z
        u, v = fx * x * w + cx, fy * y * w + cy
        screen[i, 0], screen[i, 1], screen[i, 2] = u, v, w
        # On floats, before any cast: what an integer cannot hold would come out as some other pixel.
        if -0.5 <= u < cols - 0.5 and -0.5 <= v < rows - 0.5:
            pixel[i] = _nearest(v) * cols + _nearest(u)
    return screen, pixel


@njit(cache=True)
def _nearest(a):
    """The integer whose half-open square holds `a`; floor(a + 0.5) would round 0.49999999999999994 up."""
    whole = math.floor(a)
    return int(whole) if a - whole < 0.5 else int(whole) + 1


@njit(cache=True)
def splat(screen, pixel, wanted, order, inverse_z, source):
    """Nearest of the wanted points wins its pixel; equal depths go to the smaller `order`, whatever the sequence."""
    for i in range(pixel.shape[0]):
        p = pixel[i]
        if p < 0 or not wanted[i]:
            continue
        w = screen[i, 2]
        if w > inverse_z[p] or (w == inverse_z[p] and order[i] < order[source[p]]):
            inverse_z[p] = w
            source[p] = i


@njit(cache=True)
def rasterise(points, screen, grid, stride, max_edge_mm, min_cos, inverse_z, source, in_triangle, shape, counts):
    """Draw the source grid as triangles.

    `grid` (rows, cols) holds the point of each source pixel, -1 = none. Writes inverse_z and source of the target
    image of `shape`, flat; marks in `in_triangle` the points that have neighbours to form a triangle with, drawn or
    not; and counts, by fate, the triangles that meet a pixel centre.
    """
    rows, cols = grid.shape
    target_rows, target_cols = shape
    at = np.empty(4, dtype=np.int32)
    three = np.empty((2, 3), dtype=np.int32)
    for r in range(0, rows - stride, stride):
        for c in range(0, cols - stride, stride):
            at[0], at[1] = grid[r, c], grid[r, c + stride]
            at[2], at[3] = grid[r + stride, c], grid[r + stride, c + stride]
            if (at[0] < 0) + (at[1] < 0) + (at[2] < 0) + (at[3] < 0) > 1:
                continue
            left, right, top, bottom = np.inf, -np.inf, np.inf, -np.inf
            behind = False
            for k in range(4):
                if at[k] >= 0:
                    in_triangle[at[k]] = True
                    behind |= not screen[at[k], 2] > 0.0
                    left, right = min(left, screen[at[k], 0]), max(right, screen[at[k], 0])
                    top, bottom = min(top, screen[at[k], 1]), max(bottom, screen[at[k], 1])
            if behind:
                counts[BEHIND] += 1
                continue
            # Most quads of a fine source lie between the pixel centres of a coarse target: no work for them.
            if _holds_no_integer(left, right, target_cols) or _holds_no_integer(top, bottom, target_rows):
                continue
            for t in range(_split(points, at, three)):
                i, j, k = three[t, 0], three[t, 1], three[t, 2]
                fate = _fate(points, i, j, k, max_edge_mm * max_edge_mm, min_cos)
                counts[fate] += 1
                if fate >= FLIPPED:
                    _fill(screen, i, j, k, inverse_z, source, target_rows, target_cols)


@njit(cache=True)
def _holds_no_integer(low, high, n):
    """Whether no integer of 0..n-1 lies within [low, high], to the slack of the edge test."""
    first, last = max(low - SLACK, 0.0), min(high + SLACK, n - 1.0)
    return not math.ceil(first) <= last


@njit(cache=True)
def _split(points, at, three):
    """The triangles of a quad: two, along the shorter diagonal, which follows a crease; one where a corner lacks."""
    if at[0] < 0:
        three[0] = at[1], at[3], at[2]
        return 1
    if at[1] < 0:
        three[0] = at[0], at[3], at[2]
        return 1
    if at[2] < 0:
        three[0] = at[0], at[1], at[3]
        return 1
    if at[3] < 0:
        three[0] = at[0], at[1], at[2]
        return 1
    if _distance_sq(points, at[0], at[3]) < _distance_sq(points, at[1], at[2]):
        three[0] = at[0], at[1], at[3]
        three[1] = at[0], at[3], at[2]
    else:
        three[0] = at[0], at[1], at[2]
        three[1] = at[1], at[3], at[2]
    return 2


@njit(cache=True)
def _distance_sq(points, i, j):
    x = np.float64(points[i, 0]) - np.float64(points[j, 0])
    y = np.float64(points[i, 1]) - np.float64(points[j, 1])
    z = np.float64(points[i, 2]) - np.float64(points[j, 2])
    return x * x + y * y + z * z


@njit(cache=True)
def _fate(points, i, j, k, max_edge_sq, min_cos):
    """JUMP, GRAZING, FLIPPED or KEPT, by the edges and by the angle between normal and line of sight."""
    if not (
        _distance_sq(points, i, j) <= max_edge_sq
        and _distance_sq(points, j, k) <= max_edge_sq
        and _distance_sq(points, k, i) <= max_edge_sq
    ):
        return JUMP
    ax, ay, az = np.float64(points[i, 0]), np.float64(points[i, 1]), np.float64(points[i, 2])
    bx, by, bz = points[j, 0] - ax, points[j, 1] - ay, points[j, 2] - az
    cx, cy, cz = points[k, 0] - ax, points[k, 1] - ay, points[k, 2] - az
    nx, ny, nz = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
    mx, my, mz = ax + (bx + cx) / 3.0, ay + (by + cy) / 3.0, az + (bz + cz) / 3.0
    along = nx * mx + ny * my + nz * mz
    limit_sq = min_cos * min_cos * (nx * nx + ny * ny + nz * nz) * (mx * mx + my * my + mz * mz)
    if not (along * along >= limit_sq and along != 0.0):
        return GRAZING
    return KEPT if along > 0.0 else FLIPPED


@njit(cache=True)
def _fill(screen, i, j, k, inverse_z, source, rows, cols):
    xa, ya, wa = screen[i, 0], screen[i, 1], screen[i, 2]
    xb, yb, wb = screen[j, 0], screen[j, 1], screen[j, 2]
    xc, yc, wc = screen[k, 0], screen[k, 1], screen[k, 2]
    area = (xb - xa) * (yc - ya) - (xc - xa) * (yb - ya)
    left, right = max(min(xa, xb, xc) - SLACK, 0.0), min(max(xa, xb, xc) + SLACK, cols - 1.0)
    top, bottom = max(min(ya, yb, yc) - SLACK, 0.0), min(max(ya, yb, yc) + SLACK, rows - 1.0)
    if area == 0.0 or not (left <= right and top <= bottom):
        return
    scale = 1.0 / area
    for r in range(math.ceil(top), math.floor(bottom) + 1):
        for c in range(math.ceil(left), math.floor(right) + 1):
            a = ((xb - c) * (yc - r) - (xc - c) * (yb - r)) * scale
            b = ((xc - c) * (ya - r) - (xa - c) * (yc - r)) * scale
            g = 1.0 - a - b
            if a < -SLACK or b < -SLACK or g < -SLACK:
                continue
            w = a * wa + b * wb + g * wc
            p = r * cols + c
            if w > inverse_z[p]:
                inverse_z[p] = w
                # The corner with the largest weight is the nearest one on screen.
                source[p] = i if a >= b and a >= g else (j if b >= g else k)
