"""Objects to press: each is one mesh, from which both the simulator's contact and the registration's model come.

An object's own frame has z away from the sensor: its tactile face is its side of least z.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pipeline.arrays import Doubles, freeze
from pipeline.errors import MeshProblem
from pipeline.meshes import Mesh

_FLAT = 1e-12


def bar(outline_mm: Sequence[tuple[float, float]], height_mm: float, chamfer_mm: float, name: str) -> Mesh:
    """A prism over a simple polygon, its tactile face at z = 0 chamfered by 45 degrees all around.

    Raises MeshProblem when the outline crosses itself or the chamfer is wider than the polygon.
    """
    outer = np.array(outline_mm, dtype=np.float64)
    if _crosses_itself(outer):
        raise MeshProblem(f"the outline of {name!r} must not cross itself")
    if _area(outer) < 0:
        outer = outer[::-1]
    inner = _inset(outer, chamfer_mm)
    n = len(outer)
    rings = [_at(inner, 0.0), _at(outer, chamfer_mm), _at(outer, height_mm)]
    faces = [tuple(reversed(t)) for t in _ears(inner)]  # the tactile face looks to -z
    faces += [(a + 2 * n, b + 2 * n, c + 2 * n) for a, b, c in _ears(outer)]
    for k in range(n):
        after = (k + 1) % n
        for low, high in ((0, n), (n, 2 * n)):
            faces += [(low + k, low + after, high + after), (low + k, high + after, high + k)]
    return Mesh(vertices_mm=freeze(np.concatenate(rings)), triangles=freeze(np.array(faces, dtype=np.int32)), name=name)


def notched_elbow() -> Mesh:
    """An angle piece: arms of 24 and 13 mm, 3.5 mm wide, a notch near the bend; no turn or flip maps it to itself."""
    outline = [
        (-1.75, -1.75), (11.0, -1.75), (11.0, 1.75), (6.2, 1.75), (6.2, 0.2), (4.2, 0.2), (4.2, 1.75),
        (1.75, 1.75), (1.75, 22.0), (-1.75, 22.0),
    ]  # fmt: skip
    return bar(outline, height_mm=8.0, chamfer_mm=0.5, name="notched elbow")


def _at(ring: Doubles, z_mm: float) -> Doubles:
    return np.column_stack([ring, np.full(len(ring), z_mm)])


def _area(ring: Doubles) -> float:
    after = np.roll(ring, -1, axis=0)
    return 0.5 * float((ring[:, 0] * after[:, 1] - after[:, 0] * ring[:, 1]).sum())


def _crosses_itself(ring: Doubles) -> bool:
    n = len(ring)
    for i in range(n):
        for k in range(i + 2, n - (i == 0)):  # edges that share a corner do not count
            a, b, c, d = ring[i], ring[(i + 1) % n], ring[k], ring[(k + 1) % n]
            sides = [_area(np.array([p, q, r])) > 0 for p, q, r in ((a, b, c), (a, b, d), (c, d, a), (c, d, b))]
            if sides[0] != sides[1] and sides[2] != sides[3]:
                return True
    return False


def _inset(ring: Doubles, width_mm: float) -> Doubles:
    """The polygon moved inward by `width_mm`, corners mitred; the ring runs counter-clockwise."""
    along = np.roll(ring, -1, axis=0) - ring
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    inward = np.column_stack([-along[:, 1], along[:, 0]])
    before = np.roll(inward, 1, axis=0)
    lean = 1.0 + (inward * before).sum(axis=1, keepdims=True)
    moved = ring + width_mm * (inward + before) / lean
    along_moved = np.roll(moved, -1, axis=0) - moved
    if ((along_moved * along).sum(axis=1) <= 0).any():
        raise MeshProblem(f"a chamfer of {width_mm:g} mm is wider than the shape allows")
    return moved


def _ears(ring: Doubles) -> list[tuple[int, int, int]]:
    """Triangles of a simple counter-clockwise polygon, by cutting ears."""
    left, triangles = list(range(len(ring))), []
    while len(left) > 3:
        for k, tip in enumerate(left):
            before, after = left[k - 1], left[(k + 1) % len(left)]
            corner = ring[[before, tip, after]]
            others = ring[[i for i in left if i not in (before, tip, after)]]
            if _area(corner) > _FLAT and not _inside(corner, others).any():
                triangles.append((before, tip, after))
                left.pop(k)
                break
        else:
            raise MeshProblem("the outline of a shape must not touch itself or run back on itself")
    return [*triangles, (left[0], left[1], left[2])]


def _inside(corner: Doubles, points: Doubles) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Which points lie in a counter-clockwise triangle, its border included."""
    inside = np.ones(len(points), dtype=np.bool_)
    for k in range(3):
        edge, to = corner[(k + 1) % 3] - corner[k], points - corner[k]
        inside &= edge[0] * to[:, 1] - edge[1] * to[:, 0] >= -_FLAT
    return inside
