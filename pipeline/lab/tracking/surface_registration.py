"""Register one moved membrane to another without a mesh: Gauss-Newton on distances, normals and the
contact's outline.

Residuals (`surface_residuals`) that do not move along with the object weigh little, after Geman and
McClure. Motions that the surface does not determine, such as a slide along a straight rod, keep the
prediction (`assess_observability`).
"""

import math
from dataclasses import dataclass

import numpy as np

from pipeline.core.arrays import Doubles, freeze
from pipeline.core.geometry import rigid
from pipeline.lab.tracking.membrane_surface import MembraneSurface
from pipeline.lab.tracking.surface_residuals import Residuals, compute_residuals, sample_key_points
from pipeline.stages.pose.registration.observability import (
    Observability,
    Tolerances,
    assess_observability,
    compute_correlated_covariance,
    estimate_systematic_error,
)

_ITERATIONS = 12
# motion of the moved part that ends the iterations, on the coarse and on the fine level
_CONVERGENCE_MM = (2e-2, 2e-3)
_COVARIANCE_POINTS = 200  # whose errors are correlated with each other
_OUTLIER_FACTOR = 4.0  # residuals whose square is this many times the median weigh a quarter
# A motion counts as measured where its predicted error is below these; an outline's normals are 6
# degrees off.
_TOLERANCES = Tolerances(mm=0.5, deg=4.0, normal_error_deg=6.0)
_DAMPING = 1e-6  # share of the information: keeps the solution finite


@dataclass(frozen=True, slots=True, kw_only=True)
class SurfaceFit:
    """The motion between two frames."""

    current_from_key: Doubles  # (4, 4) mm, in the sensor frame
    # (6, 6) of (rotation rad, translation mm) about the centroid of the moved part
    covariance: Doubles
    centre_mm: Doubles  # (3,) that centroid, in the current frame
    weak_directions: tuple[str, ...]  # motions that were predicted, not measured
    overlap: float  # share of the key frame's points that lie on the current frame's moved part
    agreement: float  # share of those whose residuals are as small as expected


def register_surfaces(
    key: MembraneSurface, current: MembraneSurface, start: Doubles, first_level: int = 0
) -> SurfaceFit | None:
    """The motion near `start` (4, 4) that takes the key frame's membrane to the current one's.

    It begins on `first_level` (0 = coarse). None where too little of the key frame is inside the
    current image.
    """
    motion = start
    residuals = None
    seen = None
    for level in range(first_level, len(key.levels)):
        there = sample_key_points(key, level)
        for _ in range(_ITERATIONS):
            residuals = compute_residuals(there, current, level, motion)
            if residuals is None:
                return None
            if seen is None:
                seen = _assess(residuals, key)
            step = seen.observable @ _solve(residuals)
            motion = _move(motion, step, residuals.centre_mm)
            if (
                np.linalg.norm(step[3:]) + _radius_mm(residuals) * np.linalg.norm(step[:3])
                < _CONVERGENCE_MM[level]
            ):
                break
    assert residuals is not None
    assert seen is not None
    return _describe(motion, residuals, key, seen)


def measure_overlap(key: MembraneSurface, current_from_key: Doubles) -> float:
    """Share of the key frame's points that lie inside the image after a motion."""
    there = sample_key_points(key, len(key.levels) - 1)
    moved = rigid.apply(current_from_key, there.surface.points_mm)
    return float(key.camera.project(moved)[2].mean()) if len(moved) else 0.0


def _weigh(residuals: Residuals) -> Doubles:
    """Weights (n,): 0 outside the moved part, small for outliers."""
    error_sq = residuals.error_sq
    typical = max(float(np.median(error_sq)), 1.0)
    return residuals.on_moved / (1.0 + error_sq / (_OUTLIER_FACTOR * typical)) ** 2


def _solve(residuals: Residuals) -> Doubles:
    """The motion (6,) that the linearised residuals ask for."""
    root = np.sqrt(_weigh(residuals))
    columns = (residuals.by_motion * root).reshape(6, -1)
    wanted = (residuals.errors * root).ravel()
    information = columns @ columns.T
    information += _DAMPING * np.diag(np.diag(information) + 1e-12)
    return np.asarray(-np.linalg.solve(information, columns @ wanted), np.float64)


def _move(motion: Doubles, step: Doubles, centre_mm: Doubles) -> Doubles:
    """`motion` followed by a small motion about a centre; its rotation stays orthonormal."""
    moved = rigid.rotation(step[:3])
    moved[:3, 3] = centre_mm + step[3:] - moved[:3, :3] @ centre_mm
    return rigid.orthonormalise(moved @ motion)


def _radius_mm(residuals: Residuals) -> float:
    return math.sqrt(
        float(((residuals.here.points_mm - residuals.centre_mm) ** 2).sum(axis=1).mean())
    )


def _assess(residuals: Residuals, key: MembraneSurface) -> Observability:
    points, normals = _collect_constraints(residuals)
    systematic = estimate_systematic_error(points, normals, residuals.centre_mm, key.error)
    return assess_observability(
        points,
        normals,
        residuals.centre_mm,
        key.error.rms_mm,
        systematic_error=systematic,
        tolerances=_TOLERANCES,
    )


def _collect_constraints(residuals: Residuals) -> tuple[Doubles, Doubles]:
    """Points and the directions (n, 3) along which each is held: the membrane's normals, and the
    outline's.
    """
    held = np.isfinite(residuals.outline_normals[:, 0])
    return (
        np.concatenate([residuals.here.points_mm, residuals.here.points_mm[held]]),
        np.concatenate([residuals.here.normals, residuals.outline_normals[held]]),
    )


def _describe(
    motion: Doubles, residuals: Residuals, surface: MembraneSurface, seen: Observability
) -> SurfaceFit:
    on = residuals.on_moved > 0
    small = on & (residuals.error_sq < _OUTLIER_FACTOR**2)
    points, normals = _collect_constraints(residuals)
    some = np.s_[:: max(1, len(points) // _COVARIANCE_POINTS)]
    covariance = compute_correlated_covariance(
        points[some],
        normals[some],
        residuals.centre_mm,
        seen.observable,
        noise_mm=surface.error.rms_mm,
        error=surface.error,
    )
    return SurfaceFit(
        current_from_key=freeze(motion),
        centre_mm=freeze(residuals.centre_mm),
        covariance=freeze((1.0 + 1.0 / surface.n_frames) * covariance),
        weak_directions=seen.weak_directions,
        overlap=float(on.sum()) / max(residuals.n_points, 1),
        agreement=float(small.sum()) / max(int(on.sum()), 1),
    )
