# pyright: basic
"""Compiled loops between height fields, meshes and camera rays."""

import math

import numpy as np
from numba import njit

_FAST = {"contract", "arcp", "nsz", "reassoc"}


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
    if not 1e-12 <= abs(area) < np.inf:
        return
    ny, nx = height.shape
    # Limits are put on floats, before any cast: what an integer cannot hold would come out as some other number.
    first_c = math.ceil(min(max(min(xa, xb, xc) - 1e-9, 0.0), nx + 0.0))
    last_c = math.floor(max(min(max(xa, xb, xc) + 1e-9, nx - 1.0), -1.0))
    first_r = math.ceil(min(max(min(ya, yb, yc) - 1e-9, 0.0), ny + 0.0))
    last_r = math.floor(max(min(max(ya, yb, yc) + 1e-9, ny - 1.0), -1.0))
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
                u = (ray_x[c] * z - x0) / step + 0.5
                w = (ray_y[r] * z - y0) / step + 0.5
                if 0.0 <= u < nx and 0.0 <= w < ny:
                    i, j = int(u), int(w)
                    height[j, i] = min(height[j, i], z)  # a lone reading between the nodes still stops the membrane


@njit(cache=True)
def lay_mesh(nodes, triangles, height):
    """Lower `height` to a mesh whose vertices (x, y in lattice steps, z in mm) are `nodes`."""
    for t in range(triangles.shape[0]):
        a = nodes[triangles[t, 0]]
        b = nodes[triangles[t, 1]]
        c = nodes[triangles[t, 2]]
        _triangle(a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2], height)
