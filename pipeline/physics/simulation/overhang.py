"""The lowest point of an object over the sensors, ignoring parts outside their view."""

import numpy as np

from pipeline.core.arrays import Doubles, Indices

HALF_WINDOW_MM = 6.0  # half the square, centred on the alignment frame, that all shipped gels see
_CORNERS = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
# upright triangles: area seen from above over the product of two sides, up to rounding
_UPRIGHT = 1e-12


def compute_lowest_mm(
    vertices_mm: Doubles, triangles: Indices, half_mm: float = HALF_WINDOW_MM
) -> float:
    """The lowest z of a mesh over the square; of the whole mesh if none of it is there.

    A triangle's lowest point over a square is a vertex inside, an edge's crossing of the border, or
    a corner below it.
    """
    inside = vertices_mm[(np.abs(vertices_mm[:, :2]) <= half_mm).all(axis=1), 2]
    candidates = [
        inside,
        *(
            _border_z(vertices_mm, triangles, axis, side * half_mm, half_mm)
            for axis in (0, 1)
            for side in (-1.0, 1.0)
        ),
        _corner_z(vertices_mm[triangles], half_mm),
    ]
    z = np.concatenate(candidates)
    return float(z.min()) if z.size else float(vertices_mm[:, 2].min())


def _border_z(
    vertices_mm: Doubles, triangles: Indices, axis: int, at_mm: float, half_mm: float
) -> Doubles:
    """Heights where edges cross one side of the square."""
    a, b = (vertices_mm[triangles[:, k]].reshape(-1, 3) for k in ((0, 1, 2), (1, 2, 0)))
    crosses = (a[:, axis] < at_mm) != (b[:, axis] < at_mm)
    a = a[crosses]
    b = b[crosses]
    share = ((at_mm - a[:, axis]) / (b[:, axis] - a[:, axis]))[:, None]
    points = a + share * (b - a)
    return points[np.abs(points[:, 1 - axis]) <= half_mm, 2]


def _corner_z(triangles_mm: Doubles, half_mm: float) -> Doubles:
    """Heights of the triangles (n, 3, 3) that lie over a corner of the square."""
    a = triangles_mm[:, 0]
    ab = triangles_mm[:, 1] - triangles_mm[:, 0]
    ac = triangles_mm[:, 2] - triangles_mm[:, 0]
    doubled = ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]
    heights: list[Doubles] = []
    sides = np.linalg.norm(ab, axis=1) * np.linalg.norm(ac, axis=1)
    # the lowest point of an upright triangle is on its edges
    level = np.abs(doubled) > _UPRIGHT * sides
    for corner in half_mm * _CORNERS:
        to = corner - a[level, :2]
        u = (to[:, 0] * ac[level, 1] - to[:, 1] * ac[level, 0]) / doubled[level]
        v = (ab[level, 0] * to[:, 1] - ab[level, 1] * to[:, 0]) / doubled[level]
        over = (u >= 0) & (v >= 0) & (u + v <= 1)
        heights.append(
            a[level, 2][over] + u[over] * ab[level, 2][over] + v[over] * ac[level, 2][over]
        )
    return np.concatenate(heights)
