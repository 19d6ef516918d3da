# pyright: basic
"""Compiled loops of the z-buffer: triangles lower a height field at the nodes that they cover."""

import math

import numpy as np

from pipeline.core.cached_kernels import kernel

# barycentric, and in steps of the grid: nodes on a common edge belong to both triangles
_SLACK = 1e-9


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
