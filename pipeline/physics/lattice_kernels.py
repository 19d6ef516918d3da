# pyright: basic
"""Compiled loops that rasterise meshes and depth images as height fields."""

import math

import numpy as np

from pipeline.base.cached_kernels import inner_kernel, kernel


@inner_kernel()
def _triangle(xa, ya, za, xb, yb, zb, xc, yc, zc, height):
    """Lower `height` to one triangle (in lattice coordinates) at the nodes that it covers."""
    area = (xb - xa) * (yc - ya) - (xc - xa) * (yb - ya)
    if not 1e-12 <= abs(area) < np.inf:
        return
    ny, nx = height.shape
    # Clamp before the cast: values beyond an integer's range would wrap.
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


@kernel()
def lower_to_depth_image(depth, ray_x, ray_y, x0, y0, step, joined, height):
    """Lower `height` (starts at +inf) to the surface in a depth image; NaN pixels have no surface.

    joined (rows, cols): set where a pixel belongs to a triangle.
    """
    rows, cols = depth.shape
    ny, nx = height.shape
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
                    height[j, i] = min(height[j, i], z)  # a single pixel between the nodes counts, too


@kernel()
def lower_to_mesh(nodes, triangles, height):
    """Lower `height` to a mesh whose vertices (x, y in lattice steps, z in mm) are `nodes`."""
    for t in range(triangles.shape[0]):
        a = nodes[triangles[t, 0]]
        b = nodes[triangles[t, 1]]
        c = nodes[triangles[t, 2]]
        _triangle(a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2], height)
