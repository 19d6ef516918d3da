"""Registration from many first guesses: a few points from each, all points from the best that are not the same."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Doubles, freeze
from pipeline.geometry import rigid
from pipeline.geometry.distance_grid import DistanceGrid
from pipeline.registration.gauss_newton import (
    FEWEST_POINTS,
    NOTHING_NEAR,
    Fit,
    How,
    NotDetermined,
    Points,
    fitted,
    rule,
)

# Steps of the most even additive sequence in six dimensions: powers of the root of x^7 = x + 1.
_EVEN = 1.1127756842787055 ** -np.arange(1.0, 7.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Many:
    """How starts are compared."""

    n_points: int = 120  # that each start is registered with
    n_iterations: int = 10
    settled_mm: float = 0.02
    judged_mm: float = 0.25  # scale of the robust misfit that ranks them: more than noise, less than a wrong place
    n_polished: int = 3  # registered with all points
    same_mm: float = 0.5  # poses this close at the points' middle, and in angle, are one
    same_deg: float = 3.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Found:
    """Distinct minima, best first, with their robust misfits."""

    fits: tuple[Fit, ...]
    misfits_mm: Doubles  # (n,) root of the mean robust square


def register_many(
    points_mm: NDArray[np.floating], grid: DistanceGrid, starts: Sequence[Doubles], how: How, many: Many | None = None
) -> Found | NotDetermined:
    """The distinct poses that lay points (n, 3) on the object from `starts` (sensor_from_object, (4, 4) each)."""
    points = Points.of(points_mm)
    if isinstance(points, NotDetermined):
        return points
    many = many or Many()
    rough = _rough(points, grid, starts, how, many)
    fits: list[Fit] = []
    for start in rough:
        fit = fitted(points, grid, start, how)
        if isinstance(fit, Fit) and _new(fit.sensor_from_object, [f.sensor_from_object for f in fits], points, many):
            fits.append(fit)
    if not fits:
        return NotDetermined(why=NOTHING_NEAR)
    misfits_mm = misfits(points, grid, [fit.sensor_from_object for fit in fits], many.judged_mm)
    order = np.argsort(misfits_mm, kind="stable")
    return Found(fits=tuple(fits[k] for k in order), misfits_mm=freeze(misfits_mm[order]))


def around(start: Doubles, about_mm: Doubles, n: int, turn_deg: float, shift_mm: float) -> list[Doubles]:
    """`start` and n - 1 poses evenly around it: turned up to `turn_deg` about a place, shifted up to `shift_mm`."""
    out = [start]
    for k in range(1, n):
        u = (k * _EVEN) % 1.0
        turned = rigid.rotation(np.deg2rad(turn_deg) * _in_ball(u[:3]))
        turned[:3, 3] = about_mm - turned[:3, :3] @ about_mm + shift_mm * _in_ball(u[3:])
        out.append(turned @ start)
    return out


def around_in_plane(
    start: Doubles, about_mm: Doubles, normal: Doubles, n: int, turn_deg: float, shift_mm: float
) -> list[Doubles]:
    """`start` and n - 1 poses spread evenly over the turns about `normal` and the shifts across it."""
    up = normal / np.linalg.norm(normal)
    right = np.cross(up, np.eye(3)[int(np.argmin(np.abs(up)))])
    right /= np.linalg.norm(right)
    out = [start]
    for k in range(1, n):
        u = (k * _EVEN[:3]) % 1.0
        turned = rigid.rotation(np.deg2rad(turn_deg) * (2.0 * u[0] - 1.0) * up)
        far, way = shift_mm * np.sqrt(u[1]), 2.0 * np.pi * u[2]
        shift = far * (np.cos(way) * right + np.sin(way) * np.cross(up, right))
        turned[:3, 3] = about_mm - turned[:3, :3] @ about_mm + shift
        out.append(turned @ start)
    return out


def misfits(points: Points, grid: DistanceGrid, poses: Sequence[Doubles], judged_mm: float) -> Doubles:
    """(n,) root of the mean of d^2 s^2 / (d^2 + s^2) of each pose, in mm: far points count as s = `judged_mm`."""
    turns, shifts = _apart(poses, points)
    return np.sqrt(_each(points, grid, turns, shifts, How(n_iterations=0), judged_mm))


def registered(points: Points, grid: DistanceGrid, starts: Sequence[Doubles] | Doubles, how: How) -> Doubles:
    """Where each start (n, 4, 4) leads, (n, 4, 4)."""
    turns, shifts = _apart(starts, points)
    _each(points, grid, turns, shifts, how, how.max_distance_mm)
    out = np.zeros((len(turns), 4, 4))
    out[:, :3, :3], out[:, :3, 3], out[:, 3, 3] = turns, shifts + points.about_mm, 1.0
    return out


def _rough(points: Points, grid: DistanceGrid, starts: Sequence[Doubles], how: How, many: Many) -> list[Doubles]:
    """The best places that a few points find, no two the same."""
    few = points.thinned(max(many.n_points, FEWEST_POINTS))
    turns, shifts = _apart(starts, points)
    quick = replace(how, n_iterations=many.n_iterations, settled_mm=many.settled_mm)
    cost = _each(few, grid, turns, shifts, quick, many.judged_mm)
    kept: list[Doubles] = []
    for k in np.argsort(cost, kind="stable"):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = turns[k], shifts[k] + points.about_mm
        if _new(pose, kept, points, many):
            kept.append(pose)
        if len(kept) == many.n_polished:
            break
    return kept


def _each(points: Points, grid: DistanceGrid, turns: Doubles, shifts: Doubles, how: How, judged_mm: float) -> Doubles:
    from pipeline.registration.gauss_newton_kernels import fit_each

    return fit_each(
        points.centred_mm, turns, shifts, grid.lattice, points.radius_mm, how.max_distance_mm, how.max_distance_mm,
        how.noise_mm, rule(how), how.settled_mm, how.n_iterations, judged_mm,
    )  # fmt: skip


def _apart(poses: Sequence[Doubles] | Doubles, points: Points) -> tuple[Doubles, Doubles]:
    """Rotations (n, 3, 3) and shifts (n, 3) about the points' middle, copied: the kernels move them."""
    stacked = np.array(poses, dtype=np.float64).reshape(-1, 4, 4)
    return np.ascontiguousarray(stacked[:, :3, :3]), np.ascontiguousarray(stacked[:, :3, 3] - points.about_mm)


def _new(pose: Doubles, kept: Sequence[Doubles], points: Points, many: Many) -> bool:
    """Whether a pose is none of those kept."""
    for other in kept:
        off = pose @ rigid.invert(other)
        slid_mm = float(np.linalg.norm(rigid.apply(off, points.about_mm) - points.about_mm))
        if slid_mm <= many.same_mm and rigid.angle_deg(off) <= many.same_deg:
            return False
    return True


def _in_ball(u: Doubles) -> Doubles:
    """A point of the unit ball from one of the unit cube, evenly."""
    far, z, way = u[0] ** (1 / 3), 2.0 * u[1] - 1.0, 2.0 * np.pi * u[2]
    across = np.sqrt(max(0.0, 1.0 - z * z))
    return far * np.array([across * np.cos(way), across * np.sin(way), z])
