"""Plane outlines: area, inset and triangulation, arcs of a given accuracy, and sections of ridges
and their bodies.

Sections are counter-clockwise in (offset, z), with the tactile side at z = 0. The lab's pattern
tools are beads of 1 mm radius that stand 1.07 mm proud of bodies with rounded shoulders of 7.5 mm
radius: arms of 30 mm length and 15 mm width, 37 mm from one finger to the other. Bubbles reach the
shoulders, gels do not.
"""

import math
from collections.abc import Sequence

import numpy as np

from pipeline.core.arrays import Doubles, Mask
from pipeline.core.errors import MeshProblem

# largest distance of chords from their arc; a surface curved in two directions stays within 2 um
CHORD_MM = 0.001
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

    `beyond_mm`: how much farther out a surface along the arc reaches; the chords are fine enough
    for it.
    """
    turn = math.radians(stop_deg - start_deg)
    n = max(1, math.ceil(abs(turn) / compute_arc_step_rad(radius_mm + beyond_mm)))
    angle = math.radians(start_deg) + turn * np.arange(n + 1) / n
    return np.asarray(centre_mm) + radius_mm * np.column_stack([np.cos(angle), np.sin(angle)])


def make_bow(radius_mm: float, turn_deg: float, legs_mm: float, beyond_mm: float) -> Doubles:
    """An arc (n, 2) that bulges to +x, its middle in the origin, with straight legs.

    `beyond_mm` as in `make_arc`.
    """
    half = 0.5 * turn_deg
    points = make_arc(radius_mm, -half, half, (-radius_mm, 0.0), beyond_mm=beyond_mm)
    leg = legs_mm * np.array([math.sin(math.radians(half)), math.cos(math.radians(half))])
    return np.concatenate([points[:1] - leg, points, points[-1:] + leg * (-1.0, 1.0)])


def thin_curve(dense_mm: Doubles, beyond_mm: float) -> Doubles:
    """The fewest points (m, 2) of a dense smooth curve that keep chords within `CHORD_MM`, both
    ends included.

    A chord over an angle t of radius r is off by r t^2 / 8, a surface `beyond_mm` farther out by
    more.
    """
    step = np.diff(dense_mm, axis=0)
    length = np.linalg.norm(step, axis=1)
    heading = np.unwrap(np.arctan2(step[:, 1], step[:, 0]))
    bend = np.abs(np.gradient(heading)) / length
    errors = np.concatenate(
        [[0.0], np.cumsum(np.sqrt((bend + beyond_mm * bend**2) / 8.0) * length)]
    )
    n = math.ceil(errors[-1] / math.sqrt(CHORD_MM))
    chosen = np.searchsorted(errors, errors[-1] * np.arange(n) / n)
    return dense_mm[np.append(chosen, -1)]


def orient_counter_clockwise(outline_mm: Outline | Doubles) -> Doubles:
    """The outline (n, 2) running counter-clockwise."""
    ring = np.array(outline_mm, dtype=np.float64)
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
    """Triangles of a simple counter-clockwise polygon, by ear clipping.

    MeshProblem when it touches itself.
    """
    left = list(range(len(ring)))
    triangles = []
    while len(left) > 3:
        for k, tip in enumerate(left):
            before = left[k - 1]
            after = left[(k + 1) % len(left)]
            corner = ring[[before, tip, after]]
            others = ring[[i for i in left if i not in (before, tip, after)]]
            if compute_area(corner) > _FLAT and not _inside(corner, others).any():
                triangles.append((before, tip, after))
                left.pop(k)
                break
        else:
            raise MeshProblem("the outline of a shape must not touch itself or run back on itself")
    return [*triangles, (left[0], left[1], left[2])]


def _inside(corner: Doubles, points: Doubles) -> Mask:
    """Which points lie in a counter-clockwise triangle, its border included."""
    edge = np.roll(corner, -1, axis=0) - corner
    to = points[:, None] - corner
    left = edge[:, 0] * to[..., 1] - edge[:, 1] * to[..., 0]
    return np.asarray((left >= -_FLAT).all(axis=1), np.bool_)


SHOULDER_MM = 7.5  # radius of the lab's shoulders, and half the width of its tools' arms
# half the width of bodies under compact patterns: the lab's tools are 37 mm wide between fingers
STAMP_MM = 18.5
FINE_MM = 2.0  # gels are not pressed deeper: above it, chords may be coarse
_COARSE_RAD = math.radians(10.0)


def make_crest(width_mm: float, edge_mm: float) -> Doubles:
    """Flat with rounded edges of radius `edge_mm`, at most half the width, from the left foot to
    the right; (n, 2).
    """
    flat = 0.5 * width_mm - edge_mm
    left = make_arc(edge_mm, -180.0, -90.0, (-flat, edge_mm))
    right = make_arc(edge_mm, -90.0, 0.0, (flat, edge_mm))
    return np.concatenate([left, right if flat > 0 else right[1:]])


def make_strip(width_mm: float, edge_mm: float, height_mm: float) -> Doubles:
    """A `make_crest` with vertical walls; (n, 2)."""
    half = 0.5 * width_mm
    return np.concatenate([make_crest(width_mm, edge_mm), [(half, height_mm), (-half, height_mm)]])


def make_apex(
    flank_deg: float, radius_mm: float, half_width_mm: float, height_mm: float
) -> Doubles:
    """A roof with flanks that rise by `flank_deg`, its edge rounded by `radius_mm`; (n, 2)."""
    top = make_arc(radius_mm, -90.0 - flank_deg, -90.0 + flank_deg, (0.0, radius_mm))
    eave = top[-1, 1] + (half_width_mm - top[-1, 0]) * math.tan(math.radians(flank_deg))
    walls = [
        (half_width_mm, eave),
        (half_width_mm, height_mm),
        (-half_width_mm, height_mm),
        (-half_width_mm, eave),
    ]
    return np.concatenate([top, walls])


def make_shoulder(half_mm: float, proud_mm: float, back_mm: float) -> Doubles:
    """The right side (n, 2) of a body under a ridge of this half width, from its foot at z =
    `proud_mm` to the back.

    The foot lies on a circle of `SHOULDER_MM` radius about the ridge's middle plane.
    """
    rise = math.sqrt(SHOULDER_MM**2 - half_mm**2)
    return _make_round(0.0, proud_mm + rise, math.asin(half_mm / SHOULDER_MM), back_mm)


def make_stamp(half_mm: float, back_mm: float) -> Doubles:
    """The right side (n, 2) of a body `2 STAMP_MM` wide under a compact pattern of this half width,
    from its foot.

    The foot is `FINE_MM` above the tactile side, out of reach of a gel even if tilted.
    """
    ledge = STAMP_MM - SHOULDER_MM
    return np.concatenate(
        [[(half_mm, FINE_MM)], _make_round(ledge, FINE_MM + SHOULDER_MM, 0.0, back_mm)]
    )


def place_on_shoulders(ridge_mm: Doubles, back_mm: float) -> Doubles:
    """The section (n, 2) of a ridge, given from its left foot to its right one, on a body with
    shoulders.
    """
    half, proud = ridge_mm[-1]
    right = make_shoulder(float(half), float(proud), back_mm)[1:]
    return np.concatenate([ridge_mm, right, (right * (-1.0, 1.0))[::-1]])


def _make_round(centre_mm: float, centre_z_mm: float, from_rad: float, back_mm: float) -> Doubles:
    """A quarter round of `SHOULDER_MM` from this angle off -z to the side, and the wall from
    there to the back.
    """
    lowest = centre_z_mm - FINE_MM
    until = math.acos(lowest / SHOULDER_MM) if lowest < SHOULDER_MM else 0.0
    fine = [from_rad]
    if until > from_rad:
        n = math.ceil((until - from_rad) / compute_arc_step_rad(SHOULDER_MM))
        fine = list(np.linspace(from_rad, until, n + 1))
    n = math.ceil((0.5 * math.pi - fine[-1]) / _COARSE_RAD)
    angle = np.array([*fine, *np.linspace(fine[-1], 0.5 * math.pi, n + 1)[1:]])
    round_ = np.column_stack(
        [centre_mm + SHOULDER_MM * np.sin(angle), centre_z_mm - SHOULDER_MM * np.cos(angle)]
    )
    return np.concatenate([round_, [(centre_mm + SHOULDER_MM, back_mm)]])
