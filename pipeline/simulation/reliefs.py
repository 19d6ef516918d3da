"""Random objects as height fields on the lattice, without a mesh, for training.

Balls of all sizes, flat faces from a fifth of the view to more than all of it, edges, rods, cones, ridges, threads and
woven or rough textures, alone, tilted, in unions and several at once. A relief (n, n) is the height of an object's
underside above its lowest point. All lengths are in lattice steps.
"""

import math
from collections.abc import Callable

import numpy as np

from pipeline.base.arrays import Floats

_NOWHERE = np.float32(1e6)  # above everything: no object
_WALL = 8.0  # slope beyond a rounded edge

_Draw = Callable[[np.random.Generator, Floats, Floats, float], Floats]


def make_random_relief(rng: np.random.Generator, n: int, view: float) -> Floats:
    """A random relief (n, n) float32, its lowest point 0; `view` is the length, in steps, that a camera sees."""
    x, y = _make_plane(n)
    height = _make_solid(rng, x, y, view)
    for _ in range(int(rng.choice((0, 1, 2, 4), p=(0.75, 0.14, 0.08, 0.03)))):  # unions and several objects
        more = _make_solid(rng, x, y, view) + np.float32(rng.choice((0.0, rng.exponential(2.0))))
        height = np.minimum(height, more)
    if rng.random() < 0.12:
        height = height + _make_grain(rng, n)
    return np.asarray(height - height.min(), np.float32)


def _make_plane(n: int) -> tuple[Floats, Floats]:
    along = (np.arange(n, dtype=np.float32) - np.float32(0.5 * (n - 1)))[None, :]
    return np.broadcast_to(along, (n, n)), np.broadcast_to(along.T, (n, n))


def _make_solid(rng: np.random.Generator, x: Floats, y: Floats, view: float) -> Floats:
    """One object somewhere in the view, rotated and tilted a little."""
    angle, reach = rng.uniform(0.0, 2.0 * math.pi), 0.42 * view
    dx, dy = (rng.normal(0.0, 0.4) * reach for _ in range(2))
    cos, sin = np.float32(math.cos(angle)), np.float32(math.sin(angle))
    across, along = (x - dx) * cos + (y - dy) * sin, (y - dy) * cos - (x - dx) * sin
    make = _MAKERS[int(rng.choice(len(_MAKERS), p=list(_SHARES.values())))]
    height = make(rng, np.asarray(across, np.float32), np.asarray(along, np.float32), view)
    if make in _TILTED and rng.random() < 0.6:
        lean = rng.normal(0.0, 0.02, 2)
        height = height + np.float32(lean[0]) * across + np.float32(lean[1]) * along
    return np.asarray(height - height.min(), np.float32)


def _sample_log(rng: np.random.Generator, low: float, high: float) -> float:
    return math.exp(rng.uniform(math.log(low), math.log(high)))


def _ball(rng: np.random.Generator, x: Floats, y: Floats, view: float) -> Floats:
    return _cap(np.hypot(x, y), _sample_log(rng, 0.06 * view, 0.8 * view))


def _egg(rng: np.random.Generator, x: Floats, y: Floats, view: float) -> Floats:
    radius, longer = _sample_log(rng, 0.06 * view, 0.5 * view), _sample_log(rng, 1.0, 6.0)
    return _cap(np.hypot(x, y / np.float32(longer)), radius)


def _rod(rng: np.random.Generator, x: Floats, y: Floats, view: float) -> Floats:
    radius, half = _sample_log(rng, 0.03 * view, 0.5 * view), _sample_log(rng, 0.1 * view, 2.0 * view)
    beyond = np.maximum(np.abs(y) - half, 0.0)
    return _cap(np.abs(x), radius) + _outside(beyond, 0.3 * radius)


def _face(rng: np.random.Generator, x: Floats, y: Floats, view: float) -> Floats:
    """A flat face with a rounded edge."""
    half = 0.5 * _sample_log(rng, 0.12 * view, 1.3 * view)
    return _outside(_outline(rng, x, y, half), min(_sample_log(rng, 0.5, 0.12 * view), 0.8 * half))


def _punch(rng: np.random.Generator, x: Floats, y: Floats, view: float) -> Floats:
    """A flat face with a sharp edge, as of tools and printed letters."""
    if rng.random() < 0.6:
        off = _outline(rng, x, y, 0.5 * _sample_log(rng, 0.1 * view, 0.7 * view))
    else:
        off = _strokes(rng, x, y, view) - np.float32(0.5 * _sample_log(rng, 0.03 * view, 0.12 * view))
    return _outside(off, _sample_log(rng, 0.1, 1.2))


def _outline(rng: np.random.Generator, x: Floats, y: Floats, half: float) -> Floats:
    """Approximate distance from a box, an ellipse, a polygon, a blob or a star; negative inside."""
    kind = rng.integers(5)
    if kind == 0:
        across = half * _sample_log(rng, 0.25, 1.0)
        qx, qy = np.abs(x) - half, np.abs(y) - across
        off = np.hypot(np.maximum(qx, 0), np.maximum(qy, 0)) + np.minimum(np.maximum(qx, qy), 0)
    elif kind == 1:
        wide = _sample_log(rng, 0.4, 1.0)
        off = (np.hypot(x, y / np.float32(wide)) - half) * np.float32(math.sqrt(wide))
    elif kind == 4:
        points, deep = int(rng.integers(3, 8)), rng.uniform(0.1, 0.35)
        reach = 1.0 + deep * np.cos(points * np.arctan2(y, x))
        off = (np.hypot(x, y) - np.float32(half) * reach) * 0.8
    else:
        off = _polygon(rng, x, y, half) if kind == 2 else _blob(rng, x, y, half)
    return np.asarray(off, np.float32)


def _polygon(rng: np.random.Generator, x: Floats, y: Floats, half: float) -> Floats:
    corners = int(rng.integers(3, 9))
    off = np.full(x.shape, -np.inf, np.float32)
    for side in range(corners):
        angle = 2.0 * math.pi * (side + 0.5 * rng.uniform(-0.5, 0.5)) / corners
        off = np.maximum(off, np.float32(math.cos(angle)) * x + np.float32(math.sin(angle)) * y - half)
    return off


def _blob(rng: np.random.Generator, x: Floats, y: Floats, half: float) -> Floats:
    angle, radius = np.arctan2(y, x), np.full(x.shape, half, np.float32)
    for wave in range(2, 6):
        radius += np.float32(half * rng.normal(0.0, 0.25) / wave) * np.cos(wave * angle + rng.uniform(0.0, 6.3))
    return np.asarray((np.hypot(x, y) - radius) * 0.8, np.float32)


def _edge(rng: np.random.Generator, x: Floats, y: Floats, view: float) -> Floats:
    """The edge of a roof, straight or bent to an arc, with a rounded crest."""
    steep, round_ = math.tan(math.radians(rng.uniform(12.0, 75.0))), _sample_log(rng, 0.4, 6.0)
    if rng.random() < 0.35:
        bend = _sample_log(rng, 0.12 * view, 1.5 * view)
        x = np.hypot(x - np.float32(bend), y) - np.float32(bend)
    half = _sample_log(rng, 0.1 * view, 2.0 * view)
    crest = np.hypot(steep * x, round_) - round_
    return np.asarray(crest + _outside(np.maximum(np.abs(y) - half, 0.0), round_), np.float32)


def _ridge(rng: np.random.Generator, x: Floats, y: Floats, view: float) -> Floats:
    """Strokes of one width, their edges rounded."""
    half = 0.5 * _sample_log(rng, 0.025 * view, 0.16 * view)
    return _outside(_strokes(rng, x, y, view) - np.float32(half), half * rng.uniform(0.2, 1.0))


def _strokes(rng: np.random.Generator, x: Floats, y: Floats, view: float) -> Floats:
    """Distance from lines: straight ones, rings, zigzags."""
    kind = rng.integers(3)
    if kind == 0:
        off = np.abs(np.hypot(x, y) - np.float32(_sample_log(rng, 0.08 * view, 0.45 * view)))
    elif kind == 1:
        off = np.full(x.shape, np.inf, np.float32)
        for _ in range(int(rng.integers(1, 5))):
            angle, long = rng.uniform(0.0, 2.0 * math.pi), _sample_log(rng, 0.1 * view, 1.2 * view)
            along = np.clip(x * math.cos(angle) + y * math.sin(angle), 0.0, long)
            off = np.minimum(off, np.hypot(x - along * math.cos(angle), y - along * math.sin(angle)))
    else:
        wave = _sample_log(rng, 0.1 * view, 0.6 * view)
        off = np.abs(x - np.float32(0.25 * wave) * np.sin(y * np.float32(2.0 * math.pi / wave))) * 0.7
    return np.asarray(off, np.float32)


def _cone(rng: np.random.Generator, x: Floats, y: Floats, view: float) -> Floats:
    """A tip, round or with three to six sides, perhaps cut flat."""
    steep, sides = math.tan(math.radians(rng.uniform(15.0, 65.0))), int(rng.integers(2, 7))
    away = np.hypot(x, y)
    if sides > 2:
        turn = 2.0 * math.pi / sides
        angle = np.remainder(np.arctan2(y, x), turn) - 0.5 * turn
        away = away * np.cos(angle)
    cut = _sample_log(rng, 0.5, 0.1 * view)
    return np.asarray(np.hypot(steep * np.maximum(away - 0.5 * cut, 0.0), 1.0) - 1.0, np.float32)


def _threads(rng: np.random.Generator, x: Floats, y: Floats, view: float) -> Floats:
    """Parallel ridges on a flat body or around a rod."""
    pitch = _sample_log(rng, 0.035 * view, 0.25 * view)
    high = pitch * rng.uniform(0.1, 0.6)
    lean = rng.uniform(-0.2, 0.2)
    phase = (y + np.float32(lean) * x) * np.float32(2.0 * math.pi / pitch) + rng.uniform(0.0, 6.3)
    profile = (
        np.cos(phase) if rng.random() < 0.5 else 4.0 * np.abs(np.remainder(phase / (2 * math.pi), 1.0) - 0.5) - 1.0
    )
    body = _rod(rng, x, y, view) if rng.random() < 0.5 else _face(rng, x, y, view)
    return np.asarray(body + np.float32(0.5 * high) * (1.0 - profile), np.float32)


def _bubbles(rng: np.random.Generator, x: Floats, y: Floats, view: float) -> Floats:
    """A lattice of caps, as of bubble wrap, studs or woven cloth."""
    pitch = _sample_log(rng, 0.05 * view, 0.35 * view)
    row = np.floor(y / pitch + 0.5)
    shifted = x + np.float32(0.5 * pitch) * np.remainder(row, 2.0)
    near = np.remainder(shifted + 0.5 * pitch, pitch) - 0.5 * pitch
    away = np.hypot(near, y - row * pitch)
    cap = _cap(away, pitch * rng.uniform(0.35, 1.5))
    return np.asarray(np.minimum(cap, 0.6 * pitch) + 0.3 * _egg(rng, x, y, 2.0 * view), np.float32)


def _soft(rng: np.random.Generator, x: Floats, y: Floats, view: float) -> Floats:
    """A lump without edges."""
    lump = _noise(rng, x.shape[0], _sample_log(rng, 0.06 * view, 0.4 * view)) * np.float32(
        _sample_log(rng, 1.0, 0.12 * view)
    )
    return lump + _cap(np.hypot(x, y), _sample_log(rng, 0.4 * view, 3.0 * view))


def _make_grain(rng: np.random.Generator, n: int) -> Floats:
    """Surface grain, as of cloth, leather and print."""
    return _noise(rng, n, _sample_log(rng, 1.2, 6.0)) * np.float32(_sample_log(rng, 0.08, 1.5))


def _noise(rng: np.random.Generator, n: int, grain: float) -> Floats:
    """Smooth noise (n, n) with a correlation length of `grain` steps."""
    import cv2

    coarse = max(8, math.ceil(n / max(grain, 1.0)) + 4)
    small = rng.normal(0.0, 1.0, (coarse, coarse)).astype(np.float32)
    return np.asarray(
        cv2.resize(cv2.GaussianBlur(small, (0, 0), 0.8), (n, n), interpolation=cv2.INTER_CUBIC), np.float32
    )


def _cap(away: Floats, radius: float) -> Floats:
    """Height of a ball's underside at the distance `away` from its lowest point."""
    inside = np.maximum(np.float32(radius * radius) - away * away, 0.0)
    return np.asarray(np.where(away < radius, radius - np.sqrt(inside), radius + _WALL * (away - radius)), np.float32)


def _outside(off: Floats, rounding: float) -> Floats:
    """Height of a shape with a rounded edge: 0 inside, a quarter circle toward its edge, a wall beyond.

    `off`: distance from the shape.
    """
    into = np.clip(off + rounding, 0.0, rounding)
    fillet = rounding - np.sqrt(np.maximum(rounding * rounding - into * into, 0.0))
    return np.asarray(np.minimum(fillet + _WALL * np.maximum(off, 0.0), _NOWHERE), np.float32)


_SHARES: dict[_Draw, float] = {
    _punch: 0.34, _ball: 0.18, _face: 0.12, _rod: 0.08, _edge: 0.07, _egg: 0.06, _ridge: 0.05, _cone: 0.04,
    _threads: 0.03, _bubbles: 0.015, _soft: 0.015,
}  # fmt: skip
_MAKERS = tuple(_SHARES)
_TILTED: tuple[_Draw, ...] = (_punch, _face, _edge, _rod, _ridge, _threads)
