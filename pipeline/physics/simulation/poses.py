"""Poses of objects over the sensors: the paper's grid of static presses, and motions.

All poses are `alignment_from_object`. Gels rest in the plane z = 0 of the alignment frame, z
pointing away from the sensors, so a face at -0.5 mm is pressed in by 0.5 mm. Depth is that of the
object's deepest point over the square that every gel sees: a long tool's far end, tilted below it,
presses on nothing.

The lowest point of an object over the sensors, ignoring parts outside their view.
"""

import math
from itertools import product
from typing import Literal

import numpy as np

from pipeline.core.arrays import Doubles, Indices, freeze
from pipeline.core.geometry import rigid
from pipeline.core.geometry.meshes import Mesh

HALF_WINDOW_MM = 6.0  # half the square, centred on the alignment frame, that all shipped gels see
_CORNERS = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
# upright triangles: area seen from above over the product of two sides, up to rounding
_UPRIGHT = 1e-12


def compute_lowest_mm(vertices_mm: Doubles, triangles: Indices) -> float:
    """The lowest z of a mesh over the square; of the whole mesh if none of it is there.

    A triangle's lowest point over a square is a vertex inside, an edge's crossing of the border, or
    a corner below it.
    """
    half_mm = HALF_WINDOW_MM
    heights = [vertices_mm[(np.abs(vertices_mm[:, :2]) <= half_mm).all(axis=1), 2]]
    for axis, at_mm in product((0, 1), (-half_mm, half_mm)):
        points = cut_edges(vertices_mm, triangles, axis, at_mm)
        heights.append(points[np.abs(points[:, 1 - axis]) <= half_mm, 2])
    z = np.concatenate([*heights, _corner_z(vertices_mm[triangles])])
    return float(z.min() if z.size else vertices_mm[:, 2].min())


def cut_edges(vertices_mm: Doubles, triangles: Indices, axis: int, at_mm: float) -> Doubles:
    """Points (n, 3) where edges of a mesh cross the plane at `at_mm` on an axis."""
    a, b = (vertices_mm[triangles[:, k]].reshape(-1, 3) for k in ((0, 1, 2), (1, 2, 0)))
    crosses = (a[:, axis] < at_mm) != (b[:, axis] < at_mm)
    a = a[crosses]
    along = b[crosses] - a
    return a + ((at_mm - a[:, axis]) / along[:, axis])[:, None] * along


def _corner_z(triangles_mm: Doubles) -> Doubles:
    """Heights of the triangles (n, 3, 3) that lie over a corner of the square."""
    a, b, c = triangles_mm.transpose(1, 0, 2)
    sides = np.linalg.norm(b - a, axis=1) * np.linalg.norm(c - a, axis=1)
    # the lowest point of an upright triangle is on its edges
    level = np.abs(_cross(b - a, c - a)) > _UPRIGHT * sides
    a, ab, ac = a[level], (b - a)[level], (c - a)[level]
    heights: list[Doubles] = []
    for corner in HALF_WINDOW_MM * _CORNERS:
        u = _cross(corner - a[:, :2], ac) / _cross(ab, ac)
        v = _cross(ab, corner - a[:, :2]) / _cross(ab, ac)
        over = (u >= 0) & (v >= 0) & (u + v <= 1)
        heights.append((a[:, 2] + u * ab[:, 2] + v * ac[:, 2])[over])
    return np.concatenate(heights)


def _cross(a: Doubles, b: Doubles) -> Doubles:
    """Twice the area (n,), seen from above, between vectors (n, 2) or (n, 3)."""
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


SPREAD_MM = 10.0  # side of the square of the paper's translations, centred on the alignment frame
MAX_ANGLE_DEG = 45.0  # in the plane, either way
MAX_TILT_DEG = 3.0  # out of the plane, at most: a gripper's misalignment
DEPTH_RANGE_MM = (0.3, 1.0)  # of the deepest point over the gels
CLEARANCE_MM = 14.5  # above the gels: beyond a bubble that comes 13 mm closer, as in data sets
SLIDE_RANGE_MM = (2.0, 4.0)
TWIST_RANGE_DEG = (10.0, 25.0)

MotionKind = Literal["press", "slide", "twist", "release", "full"]
MOTION_PHASES = ("press", "slide", "twist", "release")
# root of x^3 = x + 1: its powers spread points over a square most evenly (Roberts)
_PLASTIC = 1.32471795724474602596


def make_paper_grid(mesh: Mesh, *, n: int = 60, seed: int) -> tuple[Doubles, ...]:
    """Poses of `n` presses, evenly over 10 mm x 10 mm, angles within 45 degrees, small tilts,
    depths of 0.3 to 1 mm.

    Angles, tilts and depths are each drawn from n equal shares of their range, in an order of their
    own. The same seed gives the same bytes.
    """
    rng = np.random.default_rng(seed)
    spread = (rng.random(2) + np.arange(1, n + 1)[:, None] / (_PLASTIC, _PLASTIC**2)) % 1.0 - 0.5
    angle, heading, tilt, depth = ((rng.permutation(n) + rng.random(n)) / n for _ in range(4))
    lean = math.radians(MAX_TILT_DEG) * np.sqrt(tilt)  # uniform over the disc of tilts
    turn = 2.0 * math.pi * heading
    low, high = DEPTH_RANGE_MM
    columns = (
        SPREAD_MM * spread,
        math.radians(MAX_ANGLE_DEG) * (2.0 * angle - 1.0),
        lean * np.cos(turn),
        lean * np.sin(turn),
        low + (high - low) * depth,
    )
    return tuple(_make_pose(mesh, *row) for row in np.column_stack(columns).tolist())


def sample_press_pose(
    mesh: Mesh,
    rng: np.random.Generator,
    *,
    spread_mm: float = SPREAD_MM,
    angle_deg: float = MAX_ANGLE_DEG,
    tilt_deg: float = MAX_TILT_DEG,
    depth_mm: tuple[float, float] = DEPTH_RANGE_MM,
) -> Doubles:
    """The pose of one press, each value uniform over its range.

    The defaults are those of the grid.
    """
    x_mm, y_mm = rng.uniform(-0.5 * spread_mm, 0.5 * spread_mm, 2)
    lean = math.radians(tilt_deg) * math.sqrt(rng.random())
    heading = rng.uniform(0.0, 2.0 * math.pi)
    angle_rad = math.radians(angle_deg) * rng.uniform(-1.0, 1.0)
    tilt = lean * math.cos(heading), lean * math.sin(heading)
    return _make_pose(mesh, x_mm, y_mm, angle_rad, *tilt, rng.uniform(*depth_mm))


def make_motion(mesh: Mesh, kind: MotionKind, *, n: int, seed: int) -> tuple[Doubles, ...]:
    """Poses of a smooth motion of `n` frames: one phase from rest to rest, or with "full" all four
    in a row.

    A press starts clear of every sensor, slides and twists keep their depth, a release returns. The
    seed determines place, depth, direction and distance.
    """
    rng = np.random.default_rng(seed)
    start_x, start_y = rng.uniform(-0.25 * SPREAD_MM, 0.25 * SPREAD_MM, 2)
    start = math.radians(MAX_ANGLE_DEG) * rng.uniform(-1.0, 1.0)
    heading, tilt_heading = rng.uniform(0.0, 2.0 * math.pi, 2)
    lean = math.radians(MAX_TILT_DEG) * math.sqrt(rng.random())
    depth = rng.uniform(*DEPTH_RANGE_MM)
    slide = rng.uniform(*SLIDE_RANGE_MM)
    twist = math.radians(rng.uniform(*TWIST_RANGE_DEG)) * rng.choice((-1.0, 1.0))
    order = MOTION_PHASES if kind == "full" else (kind,)
    # done of each phase; a slide alone starts in contact
    done = {phase: np.full(n, float(phase == "press")) for phase in MOTION_PHASES}
    share = len(order) * (np.arange(n) / (n - 1))
    for index, phase in enumerate(order):
        done[phase] = np.array([_ease(part) for part in np.clip(share - index, 0.0, 1.0).tolist()])
    distance = slide * done["slide"]
    columns = (
        start_x + distance * math.cos(heading),
        start_y + distance * math.sin(heading),
        start + twist * done["twist"],
        np.full(n, lean * math.cos(tilt_heading)),
        np.full(n, lean * math.sin(tilt_heading)),
        depth - (depth + CLEARANCE_MM) * (1.0 - done["press"] + done["release"]),
    )
    return tuple(_make_pose(mesh, *row) for row in np.column_stack(columns).tolist())


def _ease(share: float) -> float:
    """From 0 to 1 with minimum jerk: no velocity or acceleration at either end."""
    return share**3 * (10.0 - 15.0 * share + 6.0 * share**2)


def _make_pose(
    mesh: Mesh,
    x_mm: float,
    y_mm: float,
    angle_rad: float,
    tilt_x_rad: float,
    tilt_y_rad: float,
    depth_mm: float,
) -> Doubles:
    """The pose at this place, its deepest point at this depth; negative = above the gels."""
    tilt = rigid.rotation((tilt_x_rad, tilt_y_rad, 0.0))
    level = rigid.translation(x_mm, y_mm, 0.0) @ (tilt @ rigid.rotation((0.0, 0.0, angle_rad)))
    lowest_mm = compute_lowest_mm(rigid.apply(level, mesh.vertices_mm), mesh.triangles)
    level[2, 3] = -depth_mm - lowest_mm
    return freeze(level)
