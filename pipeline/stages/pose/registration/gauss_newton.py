"""Register contact points to an object's distance grid by robust Gauss-Newton.

Weak directions are held.

The residual of a point p is the signed distance d(R^T (p - t)), its normal the distance's gradient;
there is no search for correspondences. Residuals are weighted after Geman and McClure at a scale
that shrinks with their spread. Directions that the points do not determine (X-ICP, Tuna et al.
2023) keep their initial value.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pipeline.core.arrays import Doubles, freeze
from pipeline.core.frozen import frozen
from pipeline.core.geometry import rigid
from pipeline.core.geometry.distance_grid import DistanceGrid
from pipeline.core.values.results import PoseStep
from pipeline.stages.pose.registration.observability import (
    MIN_NOISE_MM,
    NO_SYSTEMATIC_STD,
    TOLERANCES,
    SystematicStd,
    Tolerances,
)

MIN_POINTS = 6  # as many as unknowns
TOO_FEW = "fewer than 6 points are finite; a pose has six unknowns"
COINCIDENT_POINTS = "all points coincide within rounding"
_ROUNDING_SHARE = 1e-12  # share of the distance to the frame's origin: rounding
# number of points above which a subset finds the neighbourhood first; size of the subset
_SUBSET_ABOVE = 2000
_SUBSET_POINTS = 500
_SUBSET_CONVERGENCE_MM = 5e-3  # convergence (mm) of that first pass
_SCALE_FACTOR = 1.5  # factor on the subset's final scale at which all points start
NOTHING_NEAR = "no point lies within the search distance of the object"


@frozen
class FitOptions:
    """Options of one registration."""

    max_distance_mm: float = 2.0  # points farther from the object are outliers
    systematic_error: SystematicStd = NO_SYSTEMATIC_STD  # independent of the number of points
    tolerances: Tolerances = TOLERANCES  # directions known less well are held
    convergence_mm: float = 1e-4  # a smaller motion ends the iterations
    n_iterations: int = 30
    keep_steps: bool = False


@frozen
class PoseFit:
    """Result of a registration."""

    sensor_from_object: Doubles  # (4, 4) mm
    rmse_mm: float  # of the points within the search distance
    fitness: float  # share of the points within the search distance
    stop_reason: str = ""  # in words
    steps: tuple[PoseStep, ...] = ()


@frozen
class NotDetermined:
    """The reason why no pose can be estimated."""

    reason: str


@frozen
class CentredPoints:
    """Contact points about their centroid, and their rms radius: what the kernels work on."""

    centred_mm: Doubles  # (n, 3)
    centre_mm: Doubles  # (3,)
    radius_mm: float

    @classmethod
    def from_points(cls, points_mm: NDArray[np.floating]) -> CentredPoints | NotDetermined:
        """Centre the finite ones of points (n, 3)."""
        given = np.asarray(points_mm, dtype=np.float64).reshape(-1, 3)
        given = given[np.isfinite(given).all(axis=1)]
        if len(given) < MIN_POINTS:
            return NotDetermined(reason=TOO_FEW)
        # The sum of coordinates near the largest float is not finite.
        with np.errstate(over="ignore", invalid="ignore"):
            # relative to the first point: a distant frame costs no digits
            centred = given - given[0]
            about = given[0] + centred.mean(axis=0)
            centred -= centred.mean(axis=0)
            radius = float(np.sqrt((centred**2).sum(axis=1).mean()))
            together = not _ROUNDING_SHARE * (1.0 + float(np.abs(about).max())) < radius < math.inf
        if together:
            return NotDetermined(reason=COINCIDENT_POINTS)
        return cls(centred_mm=centred, centre_mm=about, radius_mm=radius)

    def thin(self, n: int) -> CentredPoints:
        """Return about `n` of the points, evenly taken."""
        step = max(1, len(self.centred_mm) // n)
        return replace(self, centred_mm=np.ascontiguousarray(self.centred_mm[::step]))


def fit_pose(
    points: CentredPoints, grid: DistanceGrid, start: Doubles, how: FitOptions
) -> PoseFit | NotDetermined:
    """Return the pose (sensor_from_object) near `start` that fits points of the sensor frame to the
    object.

    Raises CalibrationError when `start` is no rigid transform.
    """
    rows = _rows(rigid.validate_rigid(start, "the start of the registration")[None], points)
    history = np.empty((0, 14))
    scale_mm = how.max_distance_mm
    if len(points.centred_mm) >= _SUBSET_ABOVE:
        few = points.thin(_SUBSET_POINTS)
        history, found_mm = _fit(
            few, rows, grid, replace(how, convergence_mm=_SUBSET_CONVERGENCE_MM), scale_mm
        )
        scale_mm = min(_SCALE_FACTOR * found_mm, scale_mm)
    rest, _ = _fit(points, rows, grid, how, scale_mm)
    if rest[-1, 13] == 0:
        return NotDetermined(reason=NOTHING_NEAR)
    poses = np.concatenate([history[:-1], rest])
    return PoseFit(
        sensor_from_object=freeze(_pose(rest[-1], points.centre_mm)),
        rmse_mm=float(rest[-1, 12]),
        fitness=float(rest[-1, 13]),
        stop_reason=_describe_stop(rest, points.radius_mm, how),
        steps=_steps(poses, points, how) if how.keep_steps else (),
    )


def trace_iterations(
    points: CentredPoints, grid: DistanceGrid, start: Doubles, how: FitOptions
) -> tuple[PoseStep, ...]:
    """Return the iterations from one start, as `register_from_starts` runs them."""
    rows, _ = _fit(points, _rows(start[None], points), grid, how, how.max_distance_mm)
    return _steps(rows, points, how)


def register_from_starts(
    points: CentredPoints, grid: DistanceGrid, starts: Doubles, how: FitOptions
) -> Doubles:
    """Return the pose (n, 4, 4) that each start (n, 4, 4) converges to."""
    rows = _rows(starts, points)
    _fit(points, rows, grid, how, how.max_distance_mm)
    return np.array([_pose(row, points.centre_mm) for row in rows]).reshape(-1, 4, 4)


def _fit(
    points: CentredPoints, rows: Doubles, grid: DistanceGrid, how: FitOptions, scale_mm: float
) -> tuple[Doubles, float]:
    """Move `rows` (n, 12) in place.

    Return the history (k, 14) of the last row and its final scale (mm).
    """
    from pipeline.stages.pose.registration.registration_kernels import N_BINS, N_SUMS, fit_poses

    history = np.empty((how.n_iterations + 1, 14))
    ended = np.zeros((len(rows), 2))
    arrays = (
        np.empty(N_SUMS),
        np.empty(N_BINS, np.int64),
        np.empty(6),
        np.empty(6),
        (np.empty((6, 6)), np.empty((6, 6))),
    )
    text = how.tolerances
    radius_mm = points.radius_mm
    rule = (
        (how.systematic_error.rotation_mm**2, (math.radians(text.deg) * radius_mm) ** -2),
        (how.systematic_error.translation_mm**2, text.mm**-2),
        math.radians(text.normal_error_deg) ** 2,
    )
    size = (radius_mm, how.max_distance_mm, scale_mm)
    limits = (MIN_NOISE_MM, how.convergence_mm)
    fit_poses(points.centred_mm, rows, grid.lattice, size, limits, rule, arrays, history, ended)
    return history[: int(ended[-1, 0])].copy(), float(ended[-1, 1])


def _rows(poses: Doubles, points: CentredPoints) -> Doubles:
    """Return rotations and translations (n, 12) about the points' centroid."""
    return np.hstack([poses[:, :3, :3].reshape(-1, 9), poses[:, :3, 3] - points.centre_mm])


def _pose(row: Doubles, about_mm: Doubles) -> Doubles:
    pose = np.eye(4)
    pose[:3, :3] = row[:9].reshape(3, 3)
    pose[:3, 3] = row[9:12] + about_mm
    return pose


def _steps(rows: Doubles, points: CentredPoints, how: FitOptions) -> tuple[PoseStep, ...]:
    return tuple(
        PoseStep(
            sensor_from_object=freeze(_pose(row, points.centre_mm)),
            rmse_mm=float(row[12]),
            fitness=float(row[13]),
            max_correspondence_mm=how.max_distance_mm,
        )
        for row in rows
    )


def _describe_stop(rows: Doubles, radius_mm: float, how: FitOptions) -> str:
    """Return why the iterations of `rows` ended."""
    if len(rows) < 2:
        return f"nothing of the contact is within {how.max_distance_mm:g} mm of the object"
    turned = rows[-1, :9].reshape(3, 3).T @ rows[-2, :9].reshape(3, 3)
    angle = math.asin(min(1.0, float(np.linalg.norm(turned - turned.T)) / math.sqrt(8.0)))
    moved_mm = math.hypot(radius_mm * angle, float(np.linalg.norm(rows[-1, 9:12] - rows[-2, 9:12])))
    if len(rows) <= how.n_iterations or moved_mm <= how.convergence_mm:
        return (
            "converged: the last iteration moved the contact by less than "
            f"{how.convergence_mm:g} mm"
        )
    text = (
        f"ended after {len(rows) - 1} iterations, the limit: the last one still moved the "
        "contact by"
    )
    return f"{text} {moved_mm:.2g} mm"
