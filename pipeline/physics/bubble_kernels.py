# pyright: basic
"""Compiled loops of the bubble: projected multigrid for the membrane, and its way to and from a depth image.

The unknown v is the membrane's deviation from its rest shape, 0 where `free` is False (rim and beyond):
-lap v = load where v < room, -lap v <= load where v = room, and never v > room.
"""

import math

import numpy as np
from numba import njit

_FAST = {"contract", "arcp", "nsz", "reassoc"}


@njit(cache=True, fastmath=_FAST)
def smooth(v, load, room, free, step_sq, sweeps):
    """Projected Gauss-Seidel in red-black order; the largest change of the last sweep."""
    rows, cols = v.shape
    change = 0.0
    for _ in range(sweeps):
        change = 0.0
        for colour in range(2):
            for r in range(1, rows - 1):
                for c in range(1 + (r + colour) % 2, cols - 1, 2):
                    if free[r, c]:
                        new = 0.25 * (v[r - 1, c] + v[r + 1, c] + v[r, c - 1] + v[r, c + 1] + step_sq * load[r, c])
                        new = min(new, room[r, c])
                        change = max(change, abs(new - v[r, c]))
                        v[r, c] = new
    return change


@njit(cache=True, fastmath=_FAST)
def residual(v, load, room, free, step_sq, out):
    """load + lap v where the membrane is free to follow it, 0 where the object holds it or the rim does."""
    rows, cols = v.shape
    inverse = 1.0 / step_sq
    out[:] = 0.0
    for r in range(1, rows - 1):
        for c in range(1, cols - 1):
            if free[r, c]:
                lap = (v[r - 1, c] + v[r + 1, c] + v[r, c - 1] + v[r, c + 1] - 4.0 * v[r, c]) * inverse
                left = load[r, c] + lap
                if not (left > 0.0 and v[r, c] >= room[r, c]):
                    out[r, c] = left


@njit(cache=True, fastmath=_FAST)
def restrict(fine, v, room, coarse, coarse_room):
    """Full weighting of a residual, and the least room left in the 3 x 3 nodes around each coarse one."""
    rows, cols = coarse.shape
    coarse[:] = 0.0
    coarse_room[:] = math.inf
    for r in range(1, rows - 1):
        for c in range(1, cols - 1):
            y = 2 * r
            x = 2 * c
            coarse[r, c] = (
                0.25 * fine[y, x]
                + 0.125 * (fine[y - 1, x] + fine[y + 1, x] + fine[y, x - 1] + fine[y, x + 1])
                + 0.0625 * (fine[y - 1, x - 1] + fine[y - 1, x + 1] + fine[y + 1, x - 1] + fine[y + 1, x + 1])
            )
            least = math.inf
            for j in range(y - 1, y + 2):
                for i in range(x - 1, x + 2):
                    least = min(least, room[j, i] - v[j, i])
            coarse_room[r, c] = max(least, 0.0)


@njit(cache=True, fastmath=_FAST)
def prolong(coarse, v, room, free):
    """Add a coarse correction, bilinear between its nodes, without passing the object."""
    rows, cols = v.shape
    for r in range(1, rows - 1):
        for c in range(1, cols - 1):
            if free[r, c]:
                j = r // 2
                i = c // 2
                j2 = j + r % 2
                i2 = i + c % 2
                add = 0.25 * (coarse[j, i] + coarse[j, i2] + coarse[j2, i] + coarse[j2, i2])
                v[r, c] = min(v[r, c] + add, room[r, c])


@njit(cache=True, fastmath=_FAST)
def held(v, load, room, free, step_sq, force):
    """Force density (in the unit of `load`) with which the object holds the membrane; 0 where it does not."""
    rows, cols = v.shape
    inverse = 1.0 / step_sq
    force[:] = 0.0
    for r in range(1, rows - 1):
        for c in range(1, cols - 1):
            if free[r, c] and v[r, c] >= room[r, c]:
                lap = (v[r - 1, c] + v[r + 1, c] + v[r, c - 1] + v[r, c + 1] - 4.0 * v[r, c]) * inverse
                force[r, c] = max(load[r, c] + lap, 0.0)


@njit(cache=True, fastmath=_FAST)
def look(height, x0, y0, step, ray_x, ray_y, near, far, out):
    """z at which each camera ray meets the surface z = height(x, y); Newton kept inside a shrinking bracket."""
    ny, nx = height.shape
    for r in range(ray_y.size):
        for c in range(ray_x.size):
            low = near
            high = far
            z = out[r, c]
            for _ in range(60):
                u = min(max((ray_x[c] * z - x0) / step, 0.0), nx - 1.000001)
                w = min(max((ray_y[r] * z - y0) / step, 0.0), ny - 1.000001)
                i = int(u)
                j = int(w)
                a = u - i
                b = w - j
                h00 = height[j, i]
                h01 = height[j, i + 1]
                h10 = height[j + 1, i]
                h11 = height[j + 1, i + 1]
                above = (h00 * (1 - a) + h01 * a) * (1 - b) + (h10 * (1 - a) + h11 * a) * b - z
                if above > 0.0:
                    low = z
                else:
                    high = z
                if abs(above) < 1e-9:
                    break
                tilt_x = ((h01 - h00) * (1 - b) + (h11 - h10) * b) / step
                tilt_y = ((h10 - h00) * (1 - a) + (h11 - h01) * a) / step
                slope = tilt_x * ray_x[c] + tilt_y * ray_y[r] - 1.0
                z = z - above / slope if slope < -0.05 else 0.5 * (low + high)
                if not (low < z < high):
                    z = 0.5 * (low + high)
            out[r, c] = z


@njit(cache=True)
def _triangle(xa, ya, za, xb, yb, zb, xc, yc, zc, height):
    """Lower `height` to one triangle (lattice coordinates) at the nodes that it covers."""
    area = (xb - xa) * (yc - ya) - (xc - xa) * (yb - ya)
    if abs(area) < 1e-12:
        return
    ny, nx = height.shape
    first_c = max(math.ceil(min(xa, xb, xc) - 1e-9), 0)
    last_c = min(math.floor(max(xa, xb, xc) + 1e-9), nx - 1)
    first_r = max(math.ceil(min(ya, yb, yc) - 1e-9), 0)
    last_r = min(math.floor(max(ya, yb, yc) + 1e-9), ny - 1)
    for r in range(first_r, last_r + 1):
        for c in range(first_c, last_c + 1):
            b = ((c - xa) * (yc - ya) - (xc - xa) * (r - ya)) / area
            g = ((xb - xa) * (r - ya) - (c - xa) * (yb - ya)) / area
            if b >= -1e-9 and g >= -1e-9 and b + g <= 1.0 + 1e-9:
                height[r, c] = min(height[r, c], za + b * (zb - za) + g * (zc - za))


@njit(cache=True)
def lay_over(depth, ray_x, ray_y, x0, y0, step, height):
    """Lower `height` (starts at +inf) to the surface that a depth image shows; NaN pixels show nothing."""
    rows, cols = depth.shape
    ny, nx = height.shape
    joined = np.zeros((rows, cols), np.bool_)
    for r in range(rows - 1):
        for c in range(cols - 1):
            for half in range(2):
                r0, c0 = (r, c) if half == 0 else (r + 1, c + 1)
                r1, c1 = r, c + 1
                r2, c2 = r + 1, c
                za = depth[r0, c0]
                zb = depth[r1, c1]
                zc = depth[r2, c2]
                if math.isfinite(za) and math.isfinite(zb) and math.isfinite(zc):
                    joined[r0, c0] = joined[r1, c1] = joined[r2, c2] = True
                    _triangle(
                        (ray_x[c0] * za - x0) / step, (ray_y[r0] * za - y0) / step, za,
                        (ray_x[c1] * zb - x0) / step, (ray_y[r1] * zb - y0) / step, zb,
                        (ray_x[c2] * zc - x0) / step, (ray_y[r2] * zc - y0) / step, zc,
                        height,
                    )  # fmt: skip
    for r in range(rows):
        for c in range(cols):
            z = depth[r, c]
            if math.isfinite(z) and not joined[r, c]:
                i = math.floor((ray_x[c] * z - x0) / step + 0.5)
                j = math.floor((ray_y[r] * z - y0) / step + 0.5)
                if 0 <= i < nx and 0 <= j < ny:
                    height[j, i] = min(height[j, i], z)  # a lone reading between the nodes still stops the membrane


@njit(cache=True, fastmath=_FAST)
def total(v):
    """Sum of a grid, in a fixed order."""
    out = 0.0
    for r in range(v.shape[0]):
        row = 0.0
        for c in range(v.shape[1]):
            row += v[r, c]
        out += row
    return np.float64(out)
