# pyright: basic
"""Compiled loop that samples the height of a triangle mesh at grid nodes."""

from __future__ import annotations

import math

from pipeline.base.cached_kernels import kernel

_SLACK = 1e-9  # barycentric: nodes on a common edge belong to both triangles


@kernel()
def sample_mesh_heights(vertices, triangles, x, y, first, step, shape, nearest, farthest):
    """Write z of the nearest and of the farthest triangle at each node; both come as NaN = none."""
    rows, cols = shape
    for t in range(triangles.shape[0]):
        i, j, k = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        xa, ya, xb, yb, xc, yc = (
            vertices[i, 0], vertices[i, 1], vertices[j, 0], vertices[j, 1], vertices[k, 0], vertices[k, 1],
        )  # fmt: skip
        area = (xb - xa) * (yc - ya) - (xc - xa) * (yb - ya)
        if area == 0.0:
            continue
        # One node more on each side: border nodes may be outside the mesh by part of a step.
        left = max(math.floor((min(xa, xb, xc) - first[0]) / step), 0)
        right = min(math.ceil((max(xa, xb, xc) - first[0]) / step), cols - 1)
        top = max(math.floor((min(ya, yb, yc) - first[1]) / step), 0)
        bottom = min(math.ceil((max(ya, yb, yc) - first[1]) / step), rows - 1)
        for r in range(top, bottom + 1):
            for c in range(left, right + 1):
                p = r * cols + c
                a = ((xb - x[p]) * (yc - y[p]) - (xc - x[p]) * (yb - y[p])) / area
                b = ((xc - x[p]) * (ya - y[p]) - (xa - x[p]) * (yc - y[p])) / area
                g = 1.0 - a - b
                if a < -_SLACK or b < -_SLACK or g < -_SLACK:
                    continue
                z = a * vertices[i, 2] + b * vertices[j, 2] + g * vertices[k, 2]
                if not z >= nearest[p]:
                    nearest[p] = z
                if not z <= farthest[p]:
                    farthest[p] = z
