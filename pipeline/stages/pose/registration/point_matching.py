"""Match contact points to a posed object: which points lie on it, what they determine, with what
error.
"""

import math
from dataclasses import dataclass

import numpy as np

from pipeline.core.arrays import Doubles
from pipeline.core.geometry import rigid
from pipeline.core.geometry.distance_grid import DistanceGrid
from pipeline.core.values.results import DepthErrorModel
from pipeline.stages.pose.registration.observability import (
    Observability,
    SystematicStd,
    Tolerances,
    assess_observability,
    compute_correlated_covariance,
    estimate_systematic_error,
)
from pipeline.stages.pose.registration.scene import ContactScene

# standard error of a spread estimated by the median, times the root of the number of points
_MEDIAN_STD_ERROR = 1.16
_MIN_COSINE = 0.5  # cosine of contact and model normal above which both are one surface
_MIN_POINTS = 20  # points needed to assess observability
SYSTEMATIC_STD_MM = (
    # of all depths together: between nodes 0.1 mm apart a sphere of 5 mm radius sags by half of it
    0.0006
)


@dataclass(frozen=True, slots=True, kw_only=True)
class MatchedPoints:
    """Contact points on the object's surface, and their errors."""

    points_mm: Doubles  # (n, 3) in the sensor frame
    normals: Doubles  # (n, 3) of the object there
    slopes: Doubles  # (n, 1) length of the distance's gradient, below 1 near edges
    noise_mm: float  # of single points: averages out
    error: DepthErrorModel  # of the sensor, or what is left of the residuals if that is more

    def assess_observability(self, middle_mm: Doubles, tolerances: Tolerances) -> Observability:
        """Return which motions about `middle_mm` (3,) the points determine."""
        found = estimate_systematic_error(self.points_mm, self.normals, middle_mm, self.error)
        return assess_observability(
            self.points_mm,
            self.normals,
            middle_mm,
            self.noise_mm,
            tolerances=tolerances,
            systematic_error=SystematicStd(
                translation_mm=math.hypot(found.translation_mm, SYSTEMATIC_STD_MM),
                rotation_mm=math.hypot(found.rotation_mm, SYSTEMATIC_STD_MM),
            ),
        )

    def compute_covariance(self, middle_mm: Doubles, known: Observability) -> Doubles:
        """Return (6, 6) of (rotation rad, translation mm at `middle_mm`) with correlated errors."""
        return compute_correlated_covariance(
            self.points_mm,
            self.normals,
            middle_mm,
            known.observable,
            noise_mm=self.noise_mm,
            error=self.error,
            systematic_mm=SYSTEMATIC_STD_MM,
        )


def match_points(scene: ContactScene, grid: DistanceGrid, pose: Doubles) -> MatchedPoints:
    """Select the contact points on the object's surface, with its normals in the sensor frame."""
    distance_mm, gradients = grid.at(rigid.apply(rigid.invert(pose), scene.points_mm))
    slopes = np.linalg.norm(gradients, axis=1, keepdims=True)
    normals = (gradients / np.maximum(slopes, 1e-12)) @ pose[:3, :3].T
    # robust: the rim of a contact is not noise
    spread_mm = 1.4826 * float(np.median(np.abs(distance_mm)))
    # At a flat face's rim the adjacent side may be nearest; it was not touched and determines
    # nothing.
    is_matched = np.einsum("ij,ij->i", normals, scene.normals) > _MIN_COSINE
    if is_matched.sum() < _MIN_POINTS:
        is_matched[:] = True
    noise_mm = min(scene.noise_mm, spread_mm)
    known_mm = max(
        spread_mm * (1.0 - _MEDIAN_STD_ERROR / math.sqrt(len(scene.points_mm))), noise_mm
    )
    shape_mm = max(math.sqrt(known_mm**2 - noise_mm**2), scene.error.rms_mm)
    return MatchedPoints(
        points_mm=scene.points_mm[is_matched],
        normals=normals[is_matched],
        slopes=slopes[is_matched],
        noise_mm=noise_mm,
        error=DepthErrorModel(rms_mm=shape_mm, correlation_mm=scene.error.correlation_mm),
    )
