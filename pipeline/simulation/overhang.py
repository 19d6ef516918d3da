"""How far down an object reaches over the sensors, whatever of it hangs beside them."""

from __future__ import annotations

import numpy as np

from pipeline.base.arrays import Doubles, Indices

HALF_WINDOW_MM = 6.0  # of the square, centred on the alignment frame, that every gel of the shipped sensors sees
_CORNERS = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
_UPRIGHT = 1e-12  # of the square of its sides is the area under a triangle that stands upright, but for rounding


def compute_lowest_mm(vertices_mm: Doubles, triangles: Indices, half_mm: float = HALF_WINDOW_MM) -> float:
    """The least z of a mesh's surface over the square; of all of the mesh when none of it is there.

    A triangle's least z over a square is at a vertex inside, where an edge crosses the border, or at a corner below it.
    """
    inside = vertices_mm[(np.abs(vertices_mm[:, :2]) <= half_mm).all(axis=1), 2]
    found = [inside, *(_border_z(vertices_mm, triangles, axis, side * half_mm, half_mm) for axis in (0, 1)
                       for side in (-1.0, 1.0)), _corner_z(vertices_mm[triangles], half_mm)]  # fmt: skip
    z = np.concatenate(found)
    return float(z.min()) if z.size else float(vertices_mm[:, 2].min())


def _border_z(vertices_mm: Doubles, triangles: Indices, axis: int, at_mm: float, half_mm: float) -> Doubles:
    """Heights where edges cross one side of the square."""
    a, b = (vertices_mm[triangles[:, k]].reshape(-1, 3) for k in ((0, 1, 2), (1, 2, 0)))
    crosses = (a[:, axis] < at_mm) != (b[:, axis] < at_mm)
    a, b = a[crosses], b[crosses]
    share = ((at_mm - a[:, axis]) / (b[:, axis] - a[:, axis]))[:, None]
    points = a + share * (b - a)
    return points[np.abs(points[:, 1 - axis]) <= half_mm, 2]


def _corner_z(triangles_mm: Doubles, half_mm: float) -> Doubles:
    """Heights of the triangles (n, 3, 3) that lie over a corner of the square."""
    a, ab, ac = triangles_mm[:, 0], triangles_mm[:, 1] - triangles_mm[:, 0], triangles_mm[:, 2] - triangles_mm[:, 0]
    doubled = ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]
    found: list[Doubles] = []
    sides = np.linalg.norm(ab, axis=1) * np.linalg.norm(ac, axis=1)
    level = np.abs(doubled) > _UPRIGHT * sides  # an upright triangle's least height is on its edges
    for corner in half_mm * _CORNERS:
        to = corner - a[level, :2]
        u = (to[:, 0] * ac[level, 1] - to[:, 1] * ac[level, 0]) / doubled[level]
        v = (ab[level, 0] * to[:, 1] - ab[level, 1] * to[:, 0]) / doubled[level]
        over = (u >= 0) & (v >= 0) & (u + v <= 1)
        found.append(a[level, 2][over] + u[over] * ab[level, 2][over] + v[over] * ac[level, 2][over])
    return np.concatenate(found)
