"""Registration of felt points to an object's distance grid: robust Gauss-Newton with weak directions held.

The residual of a point p is the signed distance d(R^T (p - t)), its normal the distance's gradient; there is no search
for partners. Residuals are weighted after Geman and McClure at a scale that follows their spread down. Directions that
the points do not determine (X-ICP, Tuna et al. 2023) keep their first guess.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Doubles, freeze
from pipeline.geometry import rigid
from pipeline.geometry.distance_grid import DistanceGrid
from pipeline.registration.observability import TOLERANCES, Tolerances
from pipeline.values.results import PoseStep

FEWEST_POINTS = 6  # as many as there are unknowns
TOO_FEW = "fewer than 6 points are finite; a pose has six unknowns"
ONE_PLACE = "all points lie in one place, or too far away to tell"
_ONE_PLACE = 1e-12  # of the distance to the frame's origin: rounding
_MANY, _FEW = 2000, 500  # from so many points on, as few find the neighbourhood of the pose first
_ROUGHLY_MM = 5e-3  # how well they find it
_WIDER = 1.5  # the scale that all points begin with, over the one that the few ended with
NOTHING_NEAR = "no point lies within the search distance of the object"


@dataclass(frozen=True, slots=True, kw_only=True)
class How:
    """How one registration is done."""

    max_distance_mm: float = 2.0  # points farther off do not count as on the object
    noise_mm: float = 1e-3  # of the points at least; keeps a perfect fit from claiming certainty
    independent: float = 1.0  # share of the points whose errors are independent of each other
    tolerances: Tolerances = TOLERANCES  # a direction that is known less well is held
    settled_mm: float = 1e-4  # a smaller motion ends the iterations
    n_iterations: int = 30
    keep_steps: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Fit:
    """Where a registration ended."""

    sensor_from_object: Doubles  # (4, 4) mm
    rmse_mm: float  # of the points within the search distance
    fitness: float  # their share of all
    noise_mm: float  # robust spread of the residuals
    hessian: Doubles  # (6, 6) weighted J^T J of (rotation times radius, translation) about the centroid, sensor frame
    about_mm: Doubles  # (3,) that centroid
    radius_mm: float  # rms distance of the points from it, which rotations are scaled by
    frozen: Doubles  # (6, k) orthonormal directions of the hessian's space that were held
    n_iterations: int
    converged: bool
    steps: tuple[PoseStep, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class NotDetermined:
    """That, and why, no pose can be told."""

    why: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Points:
    """Felt points about their middle, with their size: what the kernels work on."""

    centred_mm: Doubles  # (n, 3)
    about_mm: Doubles  # (3,)
    radius_mm: float

    @classmethod
    def of(cls, points_mm: NDArray[np.floating]) -> Points | NotDetermined:
        """The finite ones of points (n, 3)."""
        from pipeline.registration.step_kernels import centre

        centred, about, radius = centre(np.ascontiguousarray(points_mm, dtype=np.float64).reshape(-1, 3))
        if len(centred) < FEWEST_POINTS:
            return NotDetermined(why=TOO_FEW)
        # The sum of coordinates near the largest number is not finite; nothing is felt out there.
        if not _ONE_PLACE * (1.0 + float(np.abs(about).max())) < radius < math.inf:
            return NotDetermined(why=ONE_PLACE)
        return cls(centred_mm=centred, about_mm=about, radius_mm=radius)

    def thinned(self, n: int) -> Points:
        """About `n` of the points, every so many."""
        step = max(1, len(self.centred_mm) // n)
        return replace(self, centred_mm=np.ascontiguousarray(self.centred_mm[::step]))


def register(
    points_mm: NDArray[np.floating], grid: DistanceGrid, start: Doubles, how: How | None = None
) -> Fit | NotDetermined:
    """The pose near `start` (sensor_from_object) that lays points (n, 3) of the sensor frame on the object.

    Raises CalibrationError when `start` is no rigid transform.
    """
    points = Points.of(points_mm)
    if isinstance(points, NotDetermined):
        return points
    return fitted(points, grid, start, how or How())


def fitted(points: Points, grid: DistanceGrid, start: Doubles, how: How) -> Fit | NotDetermined:
    """`register` of points that are centred already."""
    from pipeline.registration import gauss_newton_kernels as kernels

    begin = rigid.checked(start, "the start of the registration")
    turn, shift = begin[:3, :3].copy(), begin[:3, 3] - points.about_mm
    history, scale_mm = np.empty((0, 14)), how.max_distance_mm
    if len(points.centred_mm) >= _MANY:
        few = points.thinned(_FEW)
        found = kernels.fit(*_arguments(few, turn, shift, grid, replace(how, settled_mm=_ROUGHLY_MM), scale_mm))
        history, scale_mm = found[0], min(_WIDER * found[-1], scale_mm)
    rest, status, noise_mm, in_object, weak, _ = kernels.fit(*_arguments(points, turn, shift, grid, how, scale_mm))
    if status == kernels.NOTHING_NEAR:
        return NotDetermined(why=NOTHING_NEAR)
    to_sensor = np.zeros((6, 6))
    to_sensor[:3, :3] = to_sensor[3:, 3:] = turn
    poses = np.concatenate([history[:-1], rest])
    return Fit(
        sensor_from_object=freeze(_pose(rest[-1], points.about_mm)), rmse_mm=float(rest[-1, 12]),
        fitness=float(rest[-1, 13]), noise_mm=float(noise_mm), hessian=freeze(to_sensor @ in_object @ to_sensor.T),
        about_mm=freeze(points.about_mm), radius_mm=points.radius_mm, frozen=freeze(to_sensor @ weak),
        n_iterations=len(poses) - 1, converged=status == kernels.CONVERGED,
        steps=tuple(_step(row, points.about_mm) for row in poses) if how.keep_steps else (),
    )  # fmt: skip


def _arguments(
    points: Points, turn: Doubles, shift: Doubles, grid: DistanceGrid, how: How, scale_mm: float
) -> tuple[Any, ...]:
    return (points.centred_mm, turn, shift, grid.lattice, points.radius_mm, how.max_distance_mm, scale_mm,
            how.noise_mm, rule(how), how.settled_mm, how.n_iterations)  # fmt: skip


def rule(how: How) -> tuple[float, float, float, float]:
    """What a direction must be known to, as the kernels take it: share, mm, rad, rad."""
    told = how.tolerances
    return how.independent, told.mm, math.radians(told.deg), math.radians(told.normal_error_deg)


def _pose(row: Doubles, about_mm: Doubles) -> Doubles:
    pose = np.eye(4)
    pose[:3, :3] = row[:9].reshape(3, 3)
    pose[:3, 3] = row[9:12] + about_mm
    return pose


def _step(row: Doubles, about_mm: Doubles) -> PoseStep:
    return PoseStep(sensor_from_object=freeze(_pose(row, about_mm)), rmse_mm=float(row[12]), fitness=float(row[13]))
