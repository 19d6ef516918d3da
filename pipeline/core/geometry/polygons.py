"""Cut planar polygons into triangles: a fan where they are convex, else ear by ear (Meisters
1975).
"""

import numpy as np

from pipeline.core.arrays import Doubles

Triangle = tuple[int, int, int]
MOST_CORNERS = 5_000  # ears are searched in a time that grows with the square
_ROUNDING = 1e-9  # of the polygon's area


def triangulate_polygon(points: Doubles) -> list[Triangle]:
    """Triangles (corner numbers) that cover a polygon (n, 3) of 3 or more corners, turned as it is.

    Corners on a line give triangles without an area. Raises ValueError for a concave polygon that
    crosses itself or has more than `MOST_CORNERS` corners.
    """
    n = len(points)
    fan = [(0, k, k + 1) for k in range(1, n - 1)]
    if n == 3:
        return fan
    centred = points - points.mean(axis=0)
    # twice the area, by Newell's method
    normal = np.cross(centred, np.roll(centred, -1, axis=0)).sum(axis=0)
    doubled_area = float(np.linalg.norm(normal))
    if not doubled_area > 0.0:
        return fan  # without an area, however it is cut
    across = np.eye(3)[np.abs(normal).argmin()]
    right = np.cross(across, normal / doubled_area)
    right /= np.linalg.norm(right)
    # corners in the plane, counter-clockwise
    flat = centred @ np.stack([right, np.cross(normal / doubled_area, right)], axis=1)
    tolerance = _ROUNDING * doubled_area
    turns = _cross(np.roll(flat, 1, axis=0), flat, np.roll(flat, -1, axis=0))
    if (turns >= -tolerance).all() and _goes_round_once(flat):
        return fan
    if n > MOST_CORNERS:
        raise ValueError(f"a concave face of more than {MOST_CORNERS} corners")
    triangles = _cut_ears(flat, tolerance)
    covered = sum(abs(float(_cross(*(flat[k] for k in triangle)))) for triangle in triangles)
    if abs(covered - doubled_area) > 1e-6 * doubled_area:
        raise ValueError("a face that crosses itself")
    return triangles


def _cut_ears(flat: Doubles, tolerance: float) -> list[Triangle]:
    left = list(range(len(flat)))
    triangles = list[Triangle]()
    at = 0
    n_tried = 0
    while len(left) > 3:
        before = left[at - 1]
        tip = left[at]
        after = left[(at + 1) % len(left)]
        turn = float(_cross(flat[before], flat[tip], flat[after]))
        others = flat[[k for k in left if k not in (before, tip, after)]]
        if abs(turn) <= tolerance or (
            turn > 0.0 and not _holds_any(flat[[before, tip, after]], others)
        ):
            triangles.append((before, tip, after))
            del left[at]
            at = at % len(left)
            n_tried = 0
            continue
        at = (at + 1) % len(left)
        n_tried = n_tried + 1
        if n_tried > len(left):
            raise ValueError("a face that crosses itself")
    return [*triangles, (left[0], left[1], left[2])]


def _holds_any(triangle: Doubles, points: Doubles) -> bool:
    """Whether points other than its corners lie in a counter-clockwise triangle (3, 2) or on its
    sides.
    """
    points = points[~(points[:, None] == triangle[None]).all(axis=2).any(axis=1)]
    sides = [_cross(triangle[k], triangle[(k + 1) % 3], points) for k in range(3)]
    return bool((np.minimum.reduce(sides) >= 0.0).any())


def _goes_round_once(flat: Doubles) -> bool:
    """Whether the edges of a polygon without right turns turn by one circle, not by two as those
    of a star.
    """
    edges = np.roll(flat, -1, axis=0) - flat
    edges = edges[(edges != 0.0).any(axis=1)]
    angles = np.arctan2(edges[:, 1], edges[:, 0])
    turned = np.mod(np.roll(angles, -1) - angles + 0.5 * np.pi, 2 * np.pi) - 0.5 * np.pi
    return float(turned.sum()) < 3 * np.pi


def _cross(a: Doubles, b: Doubles, c: Doubles) -> Doubles:
    """Twice the signed area of triangles a, b, c of points (..., 2)."""
    u = b - a
    v = c - a
    return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]
