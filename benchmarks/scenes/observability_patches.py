"""Contact patches whose unobservable motions are known from geometry, and how well they are named.

A body that slides or turns within its own surface looks the same: a cylinder in two ways, a plane
and a sphere in three, an edge and a cone in one. These are true whatever the noise; which of the
other motions a small patch determines depends on noise and tolerances, and is judged on exact
normals, densely sampled, with a band left out in between. Not a question itself.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from pipeline.core.arrays import Doubles
from pipeline.core.geometry import rigid

BAND = 2.0
"""Motions of which between 1 / BAND and BAND times as much is seen as is asked for are neither
right nor wrong.
"""

# a named direction is the true one within this angle, in coordinates scaled by the patch's radius
SAME_DEG = 10.0

_X, _Y, _Z = np.eye(3)


@dataclass(frozen=True, slots=True, kw_only=True)
class Patch:
    """A touched part of a surface."""

    points_mm: Doubles  # (n, 3)
    normals: Doubles  # (n, 3) exact
    # (k, 6) motions (rotation, translation at the origin of the frame) that nobody can feel
    free: Doubles
    area_mm2: float

    def transform(self, pose: Doubles) -> Patch:
        """The patch in another frame."""
        turn = pose[:3, :3]
        free = self.free.copy()
        free[:, :3] = self.free[:, :3] @ turn.T
        free[:, 3:] = self.free[:, 3:] @ turn.T + np.cross(pose[:3, 3], free[:, :3])
        return Patch(
            points_mm=rigid.apply(pose, self.points_mm),
            normals=self.normals @ turn.T,
            free=free,
            area_mm2=self.area_mm2,
        )


def draw_patch(kind: str, rng: np.random.Generator, n: int) -> Patch:
    """A patch of random size of one of `KINDS`, `n` points spread at random by area, in the
    body's frame.
    """
    return KINDS[kind](rng, n)


def _rod(rng: np.random.Generator, n: int) -> Patch:
    radius = rng.uniform(1.5, 6.0)
    half_turn = math.radians(rng.uniform(20.0, 60.0))
    length = rng.uniform(4.0, 14.0)
    angle = rng.uniform(-half_turn, half_turn, n)
    along = rng.uniform(-length / 2, length / 2, n)
    normals = np.stack([np.zeros(n), np.sin(angle), np.cos(angle)], axis=1)
    return _patch(
        radius * normals + along[:, None] * _X,
        normals,
        [_turn(_X), _slide(_X)],
        2 * half_turn * radius * length,
    )


def _plane(rng: np.random.Generator, n: int) -> Patch:
    sides = rng.uniform(2.0, 12.0, 2)
    points = np.zeros((n, 3))
    points[:, :2] = rng.uniform(-0.5, 0.5, (n, 2)) * sides
    return _patch(
        points, np.tile(_Z, (n, 1)), [_slide(_X), _slide(_Y), _turn(_Z)], float(sides.prod())
    )


def _sphere(rng: np.random.Generator, n: int) -> Patch:
    radius = rng.uniform(2.0, 10.0)
    least = math.cos(math.radians(rng.uniform(20.0, 60.0)))
    height = rng.uniform(least, 1.0, n)
    angle = rng.uniform(0, 2 * math.pi, n)
    across = np.sqrt(1 - height**2)
    normals = np.stack([across * np.cos(angle), across * np.sin(angle), height], axis=1)
    area = 2 * math.pi * radius**2 * (1 - least)
    return _patch(radius * normals, normals, [_turn(_X), _turn(_Y), _turn(_Z)], area)


def _peg_end(rng: np.random.Generator, n: int) -> Patch:
    radius = rng.uniform(1.5, 6.0)
    return _patch(
        _disk(rng, n, radius),
        np.tile(_Z, (n, 1)),
        [_slide(_X), _slide(_Y), _turn(_Z)],
        math.pi * radius**2,
    )


def _peg_end_and_flank(rng: np.random.Generator, n: int) -> Patch:
    radius = rng.uniform(1.5, 6.0)
    half_turn = math.radians(rng.uniform(30.0, 70.0))
    height = rng.uniform(0.6, 2.5)
    end_mm2 = math.pi * radius**2
    flank_mm2 = 2 * half_turn * radius * height
    n_end = round(n * end_mm2 / (end_mm2 + flank_mm2))
    n_flank = n - n_end
    angle = rng.uniform(-half_turn, half_turn, n_flank)
    out = np.stack([np.cos(angle), np.sin(angle), np.zeros(n_flank)], axis=1)
    flank = radius * out - rng.uniform(0, height, n_flank)[:, None] * _Z
    points = np.concatenate([_disk(rng, n_end, radius), flank])
    return _patch(
        points, np.concatenate([np.tile(_Z, (n_end, 1)), out]), [_turn(_Z)], end_mm2 + flank_mm2
    )


def _edge(rng: np.random.Generator, n: int) -> Patch:
    slopes = np.radians(rng.uniform(15.0, 60.0, 2))
    widths = rng.uniform(1.0, 4.0, 2)
    return _roof(rng, n, slopes, widths, rng.uniform(3.0, 10.0), [_slide(_X)])


def _cone(rng: np.random.Generator, n: int) -> Patch:
    half = math.radians(rng.uniform(15.0, 60.0))
    half_turn = math.radians(rng.uniform(20.0, 60.0))
    near = rng.uniform(1.0, 4.0)
    far = rng.uniform(5.0, 10.0)
    along = np.sqrt(rng.uniform(near**2, far**2, n))  # from the apex, by area
    angle = rng.uniform(-half_turn, half_turn, n)
    out = np.stack([np.cos(angle), np.sin(angle), np.zeros(n)], axis=1)
    points = along[:, None] * (math.sin(half) * out - math.cos(half) * _Z)
    area = half_turn * math.sin(half) * (far**2 - near**2)
    return _patch(points, math.cos(half) * out + math.sin(half) * _Z, [_turn(_Z)], area)


def _tool(rng: np.random.Generator, n: int) -> Patch:
    """A roof with a gable: three planes, nothing is free."""
    slopes = np.radians(rng.uniform(20.0, 60.0, 2))
    widths = rng.uniform(1.5, 4.0, 2)
    length = rng.uniform(4.0, 10.0)
    n_gable = n // 4
    roof = _roof(rng, n - n_gable, slopes, widths, length, [])
    tilt = math.radians(rng.uniform(20.0, 60.0))
    normal = np.array([math.sin(tilt), 0.0, math.cos(tilt)])
    down = np.array([math.cos(tilt), 0.0, -math.sin(tilt)])
    gable = (
        rng.uniform(0, 2.0, n_gable)[:, None] * down + rng.uniform(-1.5, 1.5, n_gable)[:, None] * _Y
    )
    points = np.concatenate([roof.points_mm, gable + length / 2 * _X])
    return _patch(
        points,
        np.concatenate([roof.normals, np.tile(normal, (n_gable, 1))]),
        [],
        roof.area_mm2 * 4 / 3,
    )


KINDS: Mapping[str, Callable[[np.random.Generator, int], Patch]] = {
    "rod": _rod,
    "plane": _plane,
    "sphere": _sphere,
    "peg, end": _peg_end,
    "peg, end and flank": _peg_end_and_flank,
    "edge": _edge,
    "cone": _cone,
    "tool": _tool,
}


def _roof(
    rng: np.random.Generator,
    n: int,
    slopes: Doubles,
    widths: Doubles,
    length: float,
    free: list[Doubles],
) -> Patch:
    side = (rng.uniform(0, widths.sum(), n) > widths[0]).astype(np.intp)
    sign = np.where(side == 0, 1.0, -1.0)
    sine = np.sin(slopes)[side]
    cosine = np.cos(slopes)[side]
    normals = np.stack([np.zeros(n), sign * sine, cosine], axis=1)
    down = (
        np.stack([np.zeros(n), sign * cosine, -sine], axis=1)
        * (rng.uniform(0, 1, n) * widths[side])[:, None]
    )
    points = down + rng.uniform(-length / 2, length / 2, n)[:, None] * _X
    return _patch(points, normals, free, float(widths.sum()) * length)


def _patch(points: Doubles, normals: Doubles, free: list[Doubles], area_mm2: float) -> Patch:
    return Patch(
        points_mm=points, normals=normals, free=np.array(free).reshape(-1, 6), area_mm2=area_mm2
    )


def _disk(rng: np.random.Generator, n: int, radius: float) -> Doubles:
    away = radius * np.sqrt(rng.uniform(0, 1, n))
    angle = rng.uniform(0, 2 * math.pi, n)
    return np.stack([away * np.cos(angle), away * np.sin(angle), np.zeros(n)], axis=1)


def _turn(axis: Doubles) -> Doubles:
    return np.concatenate([axis, np.zeros(3)])


def _slide(axis: Doubles) -> Doubles:
    return np.concatenate([np.zeros(3), axis])
