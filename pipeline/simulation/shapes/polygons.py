"""Plane outlines: area, inset and triangulation, and arcs of a given accuracy."""

import math
from collections.abc import Sequence

import numpy as np

from pipeline.base.arrays import Doubles, Mask
from pipeline.base.errors import MeshProblem

CHORD_MM = 0.001  # largest distance of chords from their arc; a surface curved in two directions stays within 2 um
Outline = Sequence[tuple[float, float]]
_FLAT = 1e-12


def compute_arc_step_rad(radius_mm: float) -> float:
    """The largest angle whose chord stays within `CHORD_MM` of its arc."""
    return 2.0 * math.acos(max(0.0, 1.0 - CHORD_MM / radius_mm))


def make_arc(
    radius_mm: float,
    start_deg: float,
    stop_deg: float,
    centre_mm: tuple[float, float] = (0.0, 0.0),
    *,
    beyond_mm: float = 0.0,
) -> Doubles:
    """Points (n, 2) on a circle from one angle to the other, both ends included.

    `beyond_mm`: how much farther out a surface along the arc reaches; the chords are fine enough for it.
    """
    turn = math.radians(stop_deg - start_deg)
    n = max(1, math.ceil(abs(turn) / compute_arc_step_rad(radius_mm + beyond_mm)))
    angle = math.radians(start_deg) + turn * np.arange(n + 1) / n
    return np.asarray(centre_mm) + radius_mm * np.column_stack([np.cos(angle), np.sin(angle)])


def make_bow(radius_mm: float, turn_deg: float, legs_mm: float, beyond_mm: float) -> Doubles:
    """An arc (n, 2) that bulges to +x, its middle in the origin, with straight legs; `beyond_mm` as in `make_arc`."""
    half = 0.5 * turn_deg
    points = make_arc(radius_mm, -half, half, (-radius_mm, 0.0), beyond_mm=beyond_mm)
    leg = legs_mm * np.array([math.sin(math.radians(half)), math.cos(math.radians(half))])
    return np.concatenate([points[:1] - leg, points, points[-1:] + leg * (-1.0, 1.0)])


def thin_curve(dense_mm: Doubles, beyond_mm: float) -> Doubles:
    """The fewest points (m, 2) of a dense smooth curve that keep chords within `CHORD_MM`, both ends included.

    A chord over an angle t of radius r is off by r t^2 / 8, a surface `beyond_mm` farther out by more.
    """
    step = np.diff(dense_mm, axis=0)
    length, heading = np.linalg.norm(step, axis=1), np.unwrap(np.arctan2(step[:, 1], step[:, 0]))
    bend = np.abs(np.gradient(heading)) / length
    errors = np.concatenate([[0.0], np.cumsum(np.sqrt((bend + beyond_mm * bend**2) / 8.0) * length)])
    n = math.ceil(errors[-1] / math.sqrt(CHORD_MM))
    chosen = np.searchsorted(errors, errors[-1] * np.arange(n) / n)
    return dense_mm[np.append(chosen, -1)]


def orient_counter_clockwise(outline_mm: Outline | Doubles, name: str) -> Doubles:
    """The outline (n, 2) running counter-clockwise; raises MeshProblem when it crosses itself."""
    ring = np.array(outline_mm, dtype=np.float64)
    if _crosses_itself(ring):
        raise MeshProblem(f"the outline of {name!r} must not cross itself")
    return ring[::-1] if compute_area(ring) < 0 else ring


def compute_area(ring: Doubles) -> float:
    """Area in the outline's unit squared, positive when it runs counter-clockwise."""
    after = np.roll(ring, -1, axis=0)
    return 0.5 * float((ring[:, 0] * after[:, 1] - after[:, 0] * ring[:, 1]).sum())


def inset_polygon(ring: Doubles, width_mm: float) -> Doubles:
    """The polygon moved inward by `width_mm`, corners mitred; the ring runs counter-clockwise.

    Raises MeshProblem when an edge would vanish.
    """
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


def triangulate_polygon(ring: Doubles) -> list[tuple[int, int, int]]:
    """Triangles of a simple counter-clockwise polygon, by ear clipping; MeshProblem when it touches itself."""
    left, triangles = list(range(len(ring))), []
    while len(left) > 3:
        for k, tip in enumerate(left):
            before, after = left[k - 1], left[(k + 1) % len(left)]
            corner = ring[[before, tip, after]]
            others = ring[[i for i in left if i not in (before, tip, after)]]
            if compute_area(corner) > _FLAT and not _inside(corner, others).any():
                triangles.append((before, tip, after))
                left.pop(k)
                break
        else:
            raise MeshProblem("the outline of a shape must not touch itself or run back on itself")
    return [*triangles, (left[0], left[1], left[2])]


def _crosses_itself(ring: Doubles) -> bool:
    n = len(ring)
    for i in range(n):
        for k in range(i + 2, n - (i == 0)):  # edges that share a corner do not count
            a, b, c, d = ring[i], ring[(i + 1) % n], ring[k], ring[(k + 1) % n]
            sides = [compute_area(np.array([p, q, r])) > 0 for p, q, r in ((a, b, c), (a, b, d), (c, d, a), (c, d, b))]
            if sides[0] != sides[1] and sides[2] != sides[3]:
                return True
    return False


def _inside(corner: Doubles, points: Doubles) -> Mask:
    """Which points lie in a counter-clockwise triangle, its border included."""
    inside = np.ones(len(points), dtype=np.bool_)
    for k in range(3):
        edge, to = corner[(k + 1) % 3] - corner[k], points - corner[k]
        inside &= edge[0] * to[:, 1] - edge[1] * to[:, 0] >= -_FLAT
    return inside
