# pyright: basic
"""Compiled loops over height fields: heights, intersections of camera rays, and the z-buffer, whose
triangles lower the field at the nodes that they cover.
"""

from __future__ import annotations

import math

import numpy as np

from pipeline.core.cached_kernels import inline_kernel, kernel

# barycentric, and in steps of the grid: nodes on a common edge belong to both triangles
_SLACK = 1e-9


@inline_kernel()
def sample_height(surface, nx, ny, u, v):
    """(z, its change per node to the right, per node down) at grid place (u, v): bilinear, level
    beyond the border.

    `surface` holds z (ny, nx), flat. Branch-free, so that it vectorises; NaN counts as node 0.
    """
    last_x = nx - 1.0
    last_y = ny - 1.0
    # Clamped as floats: a float too large for an integer would give a random cell. NaN compares
    # false.
    u = u if u > 0.0 else 0.0
    v = v if v > 0.0 else 0.0
    u = u if u < last_x else last_x
    v = v if v < last_y else last_y
    i = min(np.int32(u), np.int32(nx - 2))
    j = min(np.int32(v), np.int32(ny - 2))
    a = u - i
    b = v - j
    first = np.uint32(j * np.int32(nx) + i)
    z00 = surface[first]
    z01 = surface[first + np.uint32(1)]
    z10 = surface[first + np.uint32(nx)]
    z11 = surface[first + np.uint32(nx + 1)]
    z = (z00 * (1 - a) + z01 * a) * (1 - b) + (z10 * (1 - a) + z11 * a) * b
    return z, (z01 - z00) * (1 - b) + (z11 - z10) * b, (z10 - z00) * (1 - a) + (z11 - z01) * a


@kernel(fastmath={"contract", "arcp", "nsz", "reassoc"})
def intersect_rays(surface, nx, ny, x0, y0, step, ray_x, ray_y, far, out):
    """Write z at which each camera ray meets the height field, from the guesses in `out` (rows,
    cols).

    Newton within a bracket that shrinks from the lens and `far`.
    """
    for r in range(ray_y.size):
        for c in range(ray_x.size):
            low = 0.0
            high = far
            z = out[r, c]
            for _ in range(60):
                h, right, down = sample_height(
                    surface, nx, ny, (ray_x[c] * z - x0) / step, (ray_y[r] * z - y0) / step
                )
                above = h - z
                if above > 0.0:
                    low = z
                else:
                    high = z
                if abs(above) < 1e-9:
                    break
                slope = (right * ray_x[c] + down * ray_y[r]) / step - 1.0
                z = z - above / slope if slope < -0.05 else 0.5 * (low + high)
                if not (low < z < high):
                    z = 0.5 * (low + high)
            out[r, c] = z


@kernel()
def lower_to_triangles(nodes, triangles, height, drawn):
    """Lower `height` (rows, cols) to the triangles whose corners are `nodes` (n, 3): column, row
    and height.

    `drawn` (rows, cols) becomes the number of the triangle that is lowest there. Triangles seen
    edge-on, and those with a corner that is not finite, cover nothing.
    """
    rows, cols = height.shape
    for t in range(triangles.shape[0]):
        a = triangles[t, 0]
        b = triangles[t, 1]
        c = triangles[t, 2]
        xa = nodes[a, 0]
        ya = nodes[a, 1]
        za = nodes[a, 2]
        xb = nodes[b, 0] - xa
        yb = nodes[b, 1] - ya
        zb = nodes[b, 2] - za
        xc = nodes[c, 0] - xa
        yc = nodes[c, 1] - ya
        zc = nodes[c, 2] - za
        area = xb * yc - xc * yb
        if not 1e-12 <= abs(area) < np.inf:
            continue
        # Clamp before the cast: values beyond an integer's range would wrap.
        left = math.ceil(min(max(xa + min(0.0, xb, xc) - _SLACK, 0.0), cols + 0.0))
        right = math.floor(max(min(xa + max(0.0, xb, xc) + _SLACK, cols - 1.0), -1.0))
        top = math.ceil(min(max(ya + min(0.0, yb, yc) - _SLACK, 0.0), rows + 0.0))
        bottom = math.floor(max(min(ya + max(0.0, yb, yc) + _SLACK, rows - 1.0), -1.0))
        # A corner far away must not widen the slack at the opposite edge, where the plane would be
        # extrapolated.
        size = abs(area)
        slack_a = _SLACK * min(1.0, (abs(xc - xb) + abs(yc - yb)) / size)
        slack_b = _SLACK * min(1.0, (abs(xc) + abs(yc)) / size)
        slack_c = _SLACK * min(1.0, (abs(xb) + abs(yb)) / size)
        for row in range(top, bottom + 1):
            for col in range(left, right + 1):
                x = col - xa
                y = row - ya
                toward_b = (x * yc - xc * y) / area
                toward_c = (xb * y - x * yb) / area
                if (
                    toward_b < -slack_b
                    or toward_c < -slack_c
                    or toward_b + toward_c > 1.0 + slack_a
                ):
                    continue
                z = za + toward_b * zb + toward_c * zc
                if z < height[row, col]:
                    height[row, col] = z
                    drawn[row, col] = t
