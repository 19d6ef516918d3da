"""A posed object beside what was felt: which points lie on it, what they determine, and how surely."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pipeline.base.arrays import Doubles
from pipeline.geometry import rigid
from pipeline.geometry.distance_grid import DistanceGrid
from pipeline.registration.observability import (
    Observability,
    SystematicStd,
    Tolerances,
    assess_observability,
    compute_correlated_covariance,
    estimate_systematic_error,
)
from pipeline.registration.scene import ContactScene
from pipeline.values.results import DepthErrorModel

_OF_SPREAD = 1.16  # standard error of a spread that the median tells, times the root of how many points
_SAME_SURFACE = 0.5  # cosine of felt and modelled normal from which on both show one surface
_FEWEST = 20  # points that observability rests on
SYSTEMATIC_STD_MM = (
    0.0006  # of all depths together: between nodes 0.1 mm apart a sphere of 5 mm radius sags by half of it
)


@dataclass(frozen=True, slots=True, kw_only=True)
class MatchedPoints:
    """Felt points on the object's surface, and their errors."""

    points_mm: Doubles  # (n, 3) in the sensor frame
    normals: Doubles  # (n, 3) of the object there
    slopes: Doubles  # (n, 1) length of the distance's gradient, 1 but near edges
    noise_mm: float  # of single points: it averages away
    error: (
        DepthErrorModel  # beside it: what the sensor's is known to be, or what is left of the residuals if that is more
    )

    def assess_observability(self, middle_mm: Doubles, tolerances: Tolerances) -> Observability:
        """Which motions about `middle_mm` (3,) the points determine."""
        found = estimate_systematic_error(self.points_mm, self.normals, middle_mm, self.error)
        return assess_observability(
            self.points_mm, self.normals, middle_mm, self.noise_mm, tolerances=tolerances,
            lasting=SystematicStd(
                translation_mm=math.hypot(found.translation_mm, SYSTEMATIC_STD_MM), rotation_mm=math.hypot(found.rotation_mm, SYSTEMATIC_STD_MM)
            ),
        )  # fmt: skip

    def compute_covariance(self, middle_mm: Doubles, known: Observability) -> Doubles:
        """(6, 6) of (rotation rad, translation mm at `middle_mm`) of what is known, as the errors go together."""
        return compute_correlated_covariance(
            self.points_mm, self.normals, middle_mm, known.observable,
            noise_mm=self.noise_mm, error=self.error, lasting_mm=SYSTEMATIC_STD_MM,
        )  # fmt: skip


def match_points(scene: ContactScene, grid: DistanceGrid, pose: Doubles) -> MatchedPoints:
    """The points that show the surface they lie on, with the object's normals turned into the sensor frame."""
    distance_mm, gradients = grid.at(rigid.apply(rigid.invert(pose), scene.points_mm))
    slopes = np.linalg.norm(gradients, axis=1, keepdims=True)
    normals = (gradients / np.maximum(slopes, 1e-12)) @ pose[:3, :3].T
    spread_mm = 1.4826 * float(np.median(np.abs(distance_mm)))  # robust: the rim of a contact is not noise
    # On a flat face's rim the wall beside it may be nearest, which was not felt and determines nothing.
    felt = np.einsum("ij,ij->i", normals, scene.normals) > _SAME_SURFACE
    if felt.sum() < _FEWEST:
        felt[:] = True
    noise_mm = min(scene.noise_mm, spread_mm)
    told_mm = max(spread_mm * (1.0 - _OF_SPREAD / math.sqrt(len(scene.points_mm))), noise_mm)
    shape_mm = max(math.sqrt(told_mm**2 - noise_mm**2), scene.error.rms_mm)
    return MatchedPoints(
        points_mm=scene.points_mm[felt], normals=normals[felt], slopes=slopes[felt], noise_mm=noise_mm,
        error=DepthErrorModel(rms_mm=shape_mm, correlation_mm=scene.error.correlation_mm),
    )  # fmt: skip
