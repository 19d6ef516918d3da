"""Random objects: random patterns on random bodies, so that networks do not learn the twelve
training objects alone.

Each is a height field, its tactile side at z = 0 facing -z: a pattern of strokes, outlines, beads
or boulders with a chamfered or rounded edge, proud of a body or without one.
"""

import math

import numpy as np

from pipeline.core.arrays import Doubles, freeze
from pipeline.core.geometry.meshes import Mesh

STEP_MM = 0.3  # of the mesh: a third of the finest detail that a bubble resolves
_HALF_MM = 24.0  # half the square that a body lies within
_REACH_MM = 18.0  # height of bodies: more than a bubble's approach, 13 mm in data sets
_RIM_MM = 0.4, 1.8  # half the width of a rim
_FAR_MM = 1e3


def make_random_body(
    rng: np.random.Generator, *, unsupported_share: float = 0.25, outline_share: float = 0.0
) -> Mesh:
    """The tactile side of a random object, z away from the sensor, its lowest point at z = 0.

    `unsupported_share`: share of the patterns without a body behind them; `outline_share`: of those
    that are the rim of a figure alone.
    """
    x, y = _make_plane()
    kind = rng.random()
    if kind < 0.68:
        pattern = _make_pattern(rng, x, y)
        if outline_share and rng.random() < outline_share:
            pattern = np.abs(pattern) - rng.uniform(*_RIM_MM)
        height = _add_body(pattern, rng, x, y, unsupported_share)
    elif kind < 0.88:
        height = _make_boulder(rng, x, y)
    else:
        height = np.minimum(
            _make_boulder(rng, x, y), _make_boulder(rng, x, y) + rng.uniform(0.0, 2.0)
        )
    if rng.random() < 0.1:
        height = height + _make_bumps(rng, x, y)
    return _make_mesh(height - height.min())


def _make_plane() -> tuple[Doubles, Doubles]:
    at = np.arange(-_HALF_MM, _HALF_MM + 0.5 * STEP_MM, STEP_MM)
    x, y = np.meshgrid(at, at)
    return x, y


def _make_pattern(rng: np.random.Generator, x: Doubles, y: Doubles) -> Doubles:
    """Signed distance (mm, negative inside) to one to three figures, joined or cut out of
    another.
    """
    pattern = _make_figure(rng, x, y)
    for _ in range(rng.integers(0, 3)):
        other = _make_figure(rng, x - rng.uniform(-7.0, 7.0), y - rng.uniform(-7.0, 7.0))
        cut = np.maximum(pattern, -other)
        leaves_enough = (cut < -0.4).sum() > 30
        pattern = cut if rng.random() < 0.3 and leaves_enough else np.minimum(pattern, other)
    return pattern


def _make_figure(rng: np.random.Generator, x: Doubles, y: Doubles) -> Doubles:
    u, v = _turn(x, y, rng.uniform(0.0, 2.0 * math.pi))
    kinds = (_line, _star, _oval, _plate, _hollow, _polygon, _arc, _wave)
    return kinds[int(rng.integers(len(kinds)))](rng, u, v)


def _turn(x: Doubles, y: Doubles, angle_rad: float) -> tuple[Doubles, Doubles]:
    """Coordinates along axes that are turned by an angle."""
    cos = math.cos(angle_rad)
    sin = math.sin(angle_rad)
    return x * cos + y * sin, y * cos - x * sin


def _star(rng: np.random.Generator, u: Doubles, v: Doubles) -> Doubles:
    return _measure_lobes(
        rng, u, v, lobes=int(rng.integers(3, 8)), depth=rng.uniform(0.1, 0.55), pointed=True
    )


def _polygon(rng: np.random.Generator, u: Doubles, v: Doubles) -> Doubles:
    return _measure_lobes(
        rng, u, v, lobes=int(rng.integers(3, 9)), depth=rng.uniform(-0.2, 0.2), pointed=False
    )


def _oval(
    rng: np.random.Generator, u: Doubles, v: Doubles, least: float = 1.0, most: float = 8.0
) -> Doubles:
    a, b = rng.uniform(least, most, 2)
    return (np.hypot(u / a, v / b) - 1.0) * min(a, b)


def _plate(rng: np.random.Generator, u: Doubles, v: Doubles) -> Doubles:
    return _box(u, v, *rng.uniform(0.6, 9.0, 2)) - rng.uniform(0.0, 0.8)


def _hollow(rng: np.random.Generator, u: Doubles, v: Doubles) -> Doubles:
    width = rng.uniform(0.5, 1.8)
    if rng.random() < 0.5:
        figure = _oval(rng, u, v, 2.5, 9.0)
    else:
        lobes = int(rng.integers(3, 7))
        figure = _measure_lobes(rng, u, v, lobes=lobes, depth=0.0, pointed=False)
    return np.abs(figure) - width


def _arc(rng: np.random.Generator, u: Doubles, v: Doubles) -> Doubles:
    radius = rng.uniform(3.0, 14.0)
    open_rad = rng.uniform(0.5, math.pi)
    angle = np.clip(np.arctan2(v, u + radius), -open_rad, open_rad)
    return np.hypot(u + radius - radius * np.cos(angle), v - radius * np.sin(angle)) - rng.uniform(
        0.4, 1.8
    )


def _wave(rng: np.random.Generator, u: Doubles, v: Doubles) -> Doubles:
    length = rng.uniform(5.0, 14.0)
    rise = rng.uniform(0.5, 2.5)
    phase = 2.0 * math.pi / length * u
    across = np.abs(v - rise * np.sin(phase)) / np.hypot(
        1.0, 2.0 * math.pi / length * rise * np.cos(phase)
    )
    return np.maximum(across - rng.uniform(0.4, 1.6), np.abs(u) - rng.uniform(4.0, 20.0))


def _line(rng: np.random.Generator, u: Doubles, v: Doubles) -> Doubles:
    """One to five straight lines, from one point or one after the other."""
    at = rng.uniform(-4.0, 4.0, 2)
    distance = np.full(u.shape, _FAR_MM)
    from_one = rng.random() < 0.5
    square = rng.random() < 0.5
    for _ in range(rng.integers(1, 6)):
        turn = rng.uniform(0.0, 2.0 * math.pi)
        length = rng.choice((rng.uniform(2.0, 9.0), 30.0), p=(0.7, 0.3))
        if square:
            turn = 0.5 * math.pi * round(turn / (0.5 * math.pi))
        to = at + length * np.array([math.cos(turn), math.sin(turn)])
        distance = np.minimum(distance, _segment(u, v, at, to))
        at = at if from_one else to
    return distance - rng.uniform(0.4, 1.8)


def _segment(u: Doubles, v: Doubles, start: Doubles, end: Doubles) -> Doubles:
    along = end - start
    share = ((u - start[0]) * along[0] + (v - start[1]) * along[1]) / max(
        float(along @ along), 1e-9
    )
    share = np.clip(share, 0.0, 1.0)
    return np.hypot(u - start[0] - share * along[0], v - start[1] - share * along[1])


def _box(u: Doubles, v: Doubles, half_u: float, half_v: float) -> Doubles:
    over_u = np.abs(u) - half_u
    over_v = np.abs(v) - half_v
    return np.hypot(np.maximum(over_u, 0.0), np.maximum(over_v, 0.0)) + np.minimum(
        np.maximum(over_u, over_v), 0.0
    )


def _measure_lobes(
    rng: np.random.Generator, u: Doubles, v: Doubles, *, lobes: int, depth: float, pointed: bool
) -> Doubles:
    """Approximate distance to a star or a regular polygon, stretched along one axis."""
    radius = rng.uniform(2.5, 9.0)
    stretch = rng.uniform(0.6, 1.0)
    angle = np.arctan2(v / stretch, u)
    out = np.hypot(u, v / stretch)
    sector = 2.0 * math.pi / lobes
    # 0 at a corner, half a sector between two corners
    within = np.abs((angle + 0.5 * sector) % sector - 0.5 * sector)
    if not pointed:
        inner = math.cos(0.5 * sector) * (1.0 - depth)
        return (out * np.cos(within - 0.5 * sector) - radius * inner) * stretch
    tip = np.array([radius, 0.0])
    dent = radius * (1.0 - depth) * math.cos(0.5 * sector)
    foot = dent * np.array([math.cos(0.5 * sector), math.sin(0.5 * sector)])
    edge = foot - tip
    normal = np.array([edge[1], -edge[0]]) / np.hypot(*edge)
    normal *= math.copysign(1.0, float(normal @ tip))  # outward
    return (
        (out * np.cos(within) - tip[0]) * normal[0] + out * np.sin(within) * normal[1]
    ) * stretch


def _add_body(
    pattern: Doubles, rng: np.random.Generator, x: Doubles, y: Doubles, unsupported_share: float
) -> Doubles:
    """Heights of a pattern with a rounded rim and of the body behind it.

    Infinite where there is neither.
    """
    edge = rng.choice((rng.uniform(0.1, 0.5), rng.uniform(0.4, 1.6)))
    rise = np.clip(pattern + edge, 0.0, edge)
    if rng.random() < 0.25:
        height = rise * rng.uniform(0.5, 2.0)  # chamfered
    else:
        height = edge - np.sqrt(np.maximum(edge * edge - rise * rise, 0.0))
    height = np.where(pattern <= 0.0, height, np.inf)
    if rng.random() < unsupported_share:  # nothing behind the pattern but its walls
        return np.where(
            pattern <= 0.0, height, np.where(pattern < STEP_MM, rng.uniform(4.0, _REACH_MM), np.inf)
        )
    proud = rng.uniform(0.5, 3.0)
    shoulder = rng.uniform(1.0, 9.0)
    if rng.random() < 0.6:
        outside = pattern - rng.uniform(0.0, 3.0)
    else:
        outside = _box(x, y, *rng.uniform(6.0, 18.0, 2)) - rng.uniform(0.0, 4.0)
    over = np.clip(outside, 0.0, shoulder)
    carried = proud + shoulder - np.sqrt(np.maximum(shoulder * shoulder - over * over, 0.0))
    steep = carried + 4.0 * np.maximum(outside - shoulder, 0.0)
    return np.minimum(height, np.where(steep < _REACH_MM, steep, np.inf))


def _make_boulder(rng: np.random.Generator, x: Doubles, y: Doubles) -> Doubles:
    """Balls, eggs, rods, cones, roofs and blunt tips, without a flat side."""
    turn = rng.uniform(0.0, 2.0 * math.pi)
    u, v = _turn(x - rng.uniform(-3.0, 3.0), y - rng.uniform(-3.0, 3.0), turn)
    kind = rng.choice(("egg", "rod", "cone", "roof", "pyramid"))
    if kind == "egg":
        a, b, c = rng.uniform(1.5, 14.0, 3)
        inside = 1.0 - (u / a) ** 2 - (v / b) ** 2
        return np.where(inside > 0.0, c - c * np.sqrt(np.maximum(inside, 0.0)), np.inf)
    blunt = rng.uniform(0.1, 1.5)
    if kind == "rod":
        radius = rng.uniform(1.2, 10.0)
        half = rng.choice((rng.uniform(2.0, 12.0), 40.0))
        off = np.hypot(np.maximum(np.abs(u) - half, 0.0) * rng.choice((1.0, 4.0)), v)
        return np.where(off < radius, radius - np.sqrt(np.maximum(radius**2 - off**2, 0.0)), np.inf)
    slope = math.tan(rng.uniform(0.25, 1.2))
    if kind == "cone":
        off = np.hypot(u, v)
    elif kind == "roof":
        off = np.hypot(np.maximum(np.abs(u) - rng.uniform(1.0, 30.0), 0.0), v)
    else:
        sides = int(rng.integers(3, 6))
        angle = np.arctan2(v, u)
        sector = 2.0 * math.pi / sides
        off = np.hypot(u, v) * np.cos((angle % sector) - 0.5 * sector)
    height = np.hypot(slope * off, blunt) - blunt
    limit = rng.uniform(3.0, 18.0)
    return np.where(off < limit, height, np.inf)


def _make_bumps(rng: np.random.Generator, x: Doubles, y: Doubles) -> Doubles:
    """Waves of several directions, as of cloth, bark and worn edges."""
    bumps = np.zeros(x.shape)
    for _ in range(6):
        turn = rng.uniform(0.0, 2.0 * math.pi)
        length = rng.uniform(1.5, 12.0)
        wave = 2.0 * math.pi / length * (x * math.cos(turn) + y * math.sin(turn)) + rng.uniform(
            0.0, 2.0 * math.pi
        )
        bumps += 0.03 * length * rng.uniform(0.2, 1.0) * np.sin(wave)
    return bumps


def _make_mesh(height_mm: Doubles) -> Mesh:
    """Mesh of the nodes (ny, nx) with a height within reach."""
    x, y = _make_plane()
    valid = height_mm < _REACH_MM
    index = np.arange(height_mm.size, dtype=np.int32).reshape(height_mm.shape)
    sides = (np.s_[:-1], np.s_[1:])
    corners = np.stack([index[rows, cols] for rows in sides for cols in sides], axis=-1)
    whole = corners[valid.ravel()[corners].all(axis=-1)]
    triangles = np.concatenate([whole[:, [0, 2, 1]], whole[:, [1, 2, 3]]])
    used, compact = np.unique(triangles, return_inverse=True)
    vertices = np.stack([x, y, height_mm], -1).reshape(-1, 3)[used]
    return Mesh(
        vertices_mm=freeze(vertices),
        triangles=freeze(compact.reshape(-1, 3).astype(np.int32)),
        name="random",
    )
