"""Poses of objects over the sensors: the paper's grid of static presses, and motions.

All poses are `alignment_from_object`. Gels rest in the plane z = 0 of the alignment frame, z
pointing away from the sensors, so a face at -0.5 mm is pressed in by 0.5 mm. Depth is that of the
object's deepest point over the square that every gel sees: a long tool's far end, tilted below it,
presses on nothing.

The lowest point of an object over the sensors, ignoring parts outside their view.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from pipeline.core.arrays import Doubles, Indices, freeze
from pipeline.core.errors import SettingProblem
from pipeline.core.geometry import rigid
from pipeline.core.geometry.meshes import Mesh

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


SPREAD_MM = 10.0  # side of the square of the paper's translations, centred on the alignment frame
MAX_ANGLE_DEG = 45.0  # in the plane, either way
MAX_TILT_DEG = 3.0  # out of the plane, at most: a gripper's misalignment
DEPTH_RANGE_MM = (0.3, 1.0)  # of the deepest point over the gels
CLEARANCE_MM = 14.5  # above the gels: beyond a bubble that comes 13 mm closer, as in data sets
SLIDE_RANGE_MM = (2.0, 4.0)
TWIST_RANGE_DEG = (10.0, 25.0)

MotionKind = Literal["press", "slide", "twist", "release", "full"]
MotionPhase = Literal["press", "slide", "twist", "release"]
MOTION_KINDS: tuple[MotionKind, ...] = ("press", "slide", "twist", "release", "full")
# root of x^3 = x + 1: its powers spread points over a square most evenly (Roberts)
_PLASTIC = 1.32471795724474602596


@dataclass(frozen=True, slots=True, kw_only=True)
class _Placement:
    """Position and orientation of an object, before its depth is made exact."""

    x_mm: float
    y_mm: float
    angle_rad: float
    tilt_rad: tuple[float, float]  # rotation vector in the alignment frame's plane
    depth_mm: float  # negative = above the gels


def make_paper_grid(mesh: Mesh, *, n: int = 60, seed: int) -> tuple[Doubles, ...]:
    """Poses of `n` presses, evenly over 10 mm x 10 mm, angles within 45 degrees, small tilts,
    depths of 0.3 to 1 mm.

    Angles, tilts and depths are each drawn from n equal shares of their range, in an order of their
    own. The same seed gives the same bytes. Raises SettingProblem when `n` is below 1.
    """
    if n < 1:
        raise SettingProblem(f"a grid needs at least one pose, got {n}")
    rng = np.random.default_rng(seed)
    spread = (rng.random(2) + np.arange(1, n + 1)[:, None] / (_PLASTIC, _PLASTIC**2)) % 1.0 - 0.5
    angle, heading, tilt, depth = ((rng.permutation(n) + rng.random(n)) / n for _ in range(4))
    lean = math.radians(MAX_TILT_DEG) * np.sqrt(tilt)  # uniform over the disc of tilts
    turn = 2.0 * math.pi * heading
    return tuple(
        _make_pose(
            mesh,
            _Placement(
                x_mm=SPREAD_MM * float(spread[k, 0]),
                y_mm=SPREAD_MM * float(spread[k, 1]),
                angle_rad=math.radians(MAX_ANGLE_DEG) * (2.0 * float(angle[k]) - 1.0),
                tilt_rad=(float(lean[k] * np.cos(turn[k])), float(lean[k] * np.sin(turn[k]))),
                depth_mm=DEPTH_RANGE_MM[0]
                + (DEPTH_RANGE_MM[1] - DEPTH_RANGE_MM[0]) * float(depth[k]),
            ),
        )
        for k in range(n)
    )


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
    return _make_pose(
        mesh,
        _Placement(
            x_mm=float(x_mm),
            y_mm=float(y_mm),
            angle_rad=math.radians(angle_deg) * rng.uniform(-1.0, 1.0),
            tilt_rad=(lean * math.cos(heading), lean * math.sin(heading)),
            depth_mm=rng.uniform(*depth_mm),
        ),
    )


def make_motion(mesh: Mesh, kind: MotionKind, *, n: int, seed: int) -> tuple[Doubles, ...]:
    """Poses of a smooth motion of `n` frames: one phase from rest to rest, or with "full" all four
    in a row.

    A press starts clear of every sensor, slides and twists keep their depth, a release returns. The
    seed determines place, depth, direction and distance. Raises SettingProblem for an unknown kind
    or fewer than two frames.
    """
    if kind not in MOTION_KINDS:
        raise SettingProblem(f"unknown motion {kind!r}; there are {', '.join(MOTION_KINDS)}")
    if n < 2:
        raise SettingProblem(f"a motion needs at least two frames, got {n}")
    place_at = _make_path(kind, np.random.default_rng(seed))
    return tuple(_make_pose(mesh, place_at(float(share))) for share in np.arange(n) / (n - 1))


def _make_path(kind: MotionKind, rng: np.random.Generator) -> Callable[[float], _Placement]:
    """The placement at each share 0..1 of the motion."""
    start_x, start_y = rng.uniform(-0.25 * SPREAD_MM, 0.25 * SPREAD_MM, 2)
    start = math.radians(MAX_ANGLE_DEG) * rng.uniform(-1.0, 1.0)
    heading, tilt_heading = rng.uniform(0.0, 2.0 * math.pi, 2)
    lean = math.radians(MAX_TILT_DEG) * math.sqrt(rng.random())
    depth = rng.uniform(*DEPTH_RANGE_MM)
    slide = rng.uniform(*SLIDE_RANGE_MM)
    twist = math.radians(rng.uniform(*TWIST_RANGE_DEG)) * rng.choice((-1.0, 1.0))
    order: tuple[MotionPhase, ...] = (
        ("press", "slide", "twist", "release") if kind == "full" else (kind,)
    )

    def interpolate_pose(share: float) -> _Placement:
        index = min(int(share * len(order)), len(order) - 1)
        now = _ease(share * len(order) - index)

        def compute_phase_progress(phase: MotionPhase) -> float:
            if phase not in order:
                return 1.0 if phase == "press" else 0.0  # a slide alone starts in contact
            return now if order[index] == phase else float(order.index(phase) < index)

        distance = slide * compute_phase_progress("slide")
        lift = 1.0 - compute_phase_progress("press") + compute_phase_progress("release")
        return _Placement(
            x_mm=float(start_x + distance * math.cos(heading)),
            y_mm=float(start_y + distance * math.sin(heading)),
            angle_rad=float(start + twist * compute_phase_progress("twist")),
            tilt_rad=(lean * math.cos(tilt_heading), lean * math.sin(tilt_heading)),
            depth_mm=float(depth - (depth + CLEARANCE_MM) * lift),
        )

    return interpolate_pose


def _ease(share: float) -> float:
    """From 0 to 1 with minimum jerk: no velocity or acceleration at either end."""
    return share**3 * (10.0 - 15.0 * share + 6.0 * share**2)


def _make_pose(mesh: Mesh, placement: _Placement) -> Doubles:
    rotation = rigid.rotation((*placement.tilt_rad, 0.0)) @ rigid.rotation(
        (0.0, 0.0, placement.angle_rad)
    )
    level = rigid.translation(placement.x_mm, placement.y_mm, 0.0) @ rotation
    level[2, 3] = -placement.depth_mm - compute_lowest_mm(
        rigid.apply(level, mesh.vertices_mm), mesh.triangles
    )
    return freeze(level)
