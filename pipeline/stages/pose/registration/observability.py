"""Estimate how well a contact determines a pose, and which motions it does not observe.

J_i = [((x_i - c) x n_i)^T, n_i^T] is the change of point i's distance along its normal by a small
motion (rotation about the scene's centroid c, translation); Cov = sigma^2 (J^T J)^-1 (valid for
point-to-plane, Bonnabel 2014), with as many points as are independent, plus an error that does not
average out.

J^T J overestimates: facets of a round rod and the distance grid's gradients have normals off by an
angle e, which adds e^2 of every motion along the surface. So a direction counts as determined only
if its information exceeds that, and places it within a tolerance.

Match contact points to a posed object: which points lie on it, what they determine, with what
error.
"""

import math

import numpy as np

from pipeline.core.arrays import Doubles
from pipeline.core.frozen import frozen
from pipeline.core.geometry import rigid
from pipeline.core.geometry.distance_grid import DistanceGrid
from pipeline.core.geometry.screws import describe_motions
from pipeline.core.values.results import DepthErrorModel
from pipeline.stages.pose.registration.scene import ContactScene

MIN_NOISE_MM = 1e-3  # of a tactile depth; avoids a zero covariance
NORMAL_ERROR_DEG = 3.0
"""rms, in each of two directions, of what a mesh and its distance grid say.

Facets that leave a round part of 1 mm radius by 2 um are off by 2 degrees, and errors that hang
together over a patch exceed their mean. It is also where an offset of all depths by 10 um shifts
the answer by 0.2 mm: less slope is no hold.
"""
# points in correlated covariances: final, and in between
_MAX_CORRELATED = 500
_MAX_CORRELATED_DRAFT = 150
# share of the information that counts as none, so that variances stay finite
_NO_INFORMATION = 1e-9


@frozen
class Tolerances:
    """Uncertainty below which a motion counts as determined."""

    mm: float = 0.2  # predicted standard deviation of a translation of the contact's centroid
    deg: float = 1.0  # of a rotation about it
    normal_error_deg: float = NORMAL_ERROR_DEG  # of the model's normals


TOLERANCES = Tolerances()


@frozen
class SystematicStd:
    """Standard deviations that do not average out over the points.

    A smooth error affects rotations by its differences across the contact, translations by its
    mean.
    """

    translation_mm: float = 0.0
    rotation_mm: float = 0.0  # at the points' rms distance from the centroid


NO_SYSTEMATIC_STD = SystematicStd()


@frozen
class Observability:
    """What the data determine, about the scene's centroid, in the sensor frame."""

    # (6, 6) of (rotation rad, translation mm); large but finite where undetermined
    covariance: Doubles
    observable: Doubles  # (6, 6) idempotent: projects a motion to its determined part
    weak_directions: tuple[str, ...]  # undetermined motions in words
    weak_motions: Doubles  # (k, 6) of (rotation rad, translation mm), each of 1 mm rms
    systematic_error: SystematicStd = NO_SYSTEMATIC_STD
    tolerances: Tolerances = TOLERANCES  # that they were assessed with


def assess_observability(
    points_mm: Doubles,
    normals: Doubles,
    about_mm: Doubles,
    noise_mm: float,
    *,
    systematic_error: SystematicStd = NO_SYSTEMATIC_STD,
    tolerances: Tolerances = TOLERANCES,
) -> Observability:
    """Assess matched points (n, 3) with the object's normals there, about the scene's centroid.

    `noise_mm` is the spread of residuals, `systematic_error` the error that does not average out.
    Rotations are scaled by the     points' rms distance from the centroid, so that all six
    directions are in mm.
    """
    arms = points_mm - about_mm
    jacobian, radius_mm = _jacobian(points_mm, normals, about_mm)
    information = _sum_products(jacobian, jacobian) / len(points_mm)
    alone = max(noise_mm, MIN_NOISE_MM) ** 2 / len(points_mm)
    shift_mm2 = alone + systematic_error.translation_mm**2
    turn_mm2 = alone + systematic_error.rotation_mm**2
    fake = (
        _along_surface(arms / radius_mm, information)
        * math.radians(tolerances.normal_error_deg) ** 2
    )
    required = fake + _required_information(turn_mm2, shift_mm2, radius_mm, tolerances)
    lost = _find_undetermined(information, required)
    to_mm = np.array([radius_mm] * 3 + [1.0] * 3)  # (rad, mm) -> mm
    projector = np.eye(6) - lost @ lost.T
    named = describe_motions(
        lost,
        np.asarray(about_mm, dtype=np.float64),
        radius_mm,
        lambda v: bool(v @ (information - required) @ v < 0.0),
    )
    return Observability(
        covariance=_covariance(information, projector, max(turn_mm2, shift_mm2))
        / np.outer(to_mm, to_mm),
        observable=projector * to_mm[None, :] / to_mm[:, None],
        weak_directions=tuple(words for words, _ in named),
        weak_motions=np.array([motion / to_mm for _, motion in named]).reshape(-1, 6),
        systematic_error=systematic_error,
        tolerances=tolerances,
    )


def compute_correlated_covariance(
    points_mm: Doubles,
    normals: Doubles,
    about_mm: Doubles,
    observable: Doubles,
    *,
    noise_mm: float,
    error: DepthErrorModel,
    systematic_mm: float = 0.0,
) -> Doubles:
    """Return the (6, 6) covariance of (rotation rad, translation mm) of the `observable` motions,
    by correlated errors.

    (J^T J)^-1 J^T C J (J^T J)^-1: C is the sum of the noise of single points, of `error`, which is
    rms^2 exp(-d^2 / (2 l^2)) between points d apart, and of the error that does not average out.
    """
    jacobian, radius_mm = _jacobian(points_mm, normals, about_mm)
    to_mm = np.array([radius_mm] * 3 + [1.0] * 3)
    pulls = _correlated_information(points_mm, jacobian, error.correlation_mm, _MAX_CORRELATED)
    projector = observable * to_mm[:, None] / to_mm[None, :]
    whole = _covariance(_sum_products(jacobian, jacobian) / len(points_mm), projector, 1.0)
    known = projector @ whole @ projector
    alone = max(noise_mm, MIN_NOISE_MM) ** 2 / len(points_mm) + systematic_mm**2
    shape = error.rms_mm**2
    found = alone * known + shape * known @ pulls @ known + (alone + shape) * (whole - known)
    return 0.5 * (found + found.T) / np.outer(to_mm, to_mm)


def estimate_systematic_error(
    points_mm: Doubles, normals: Doubles, about_mm: Doubles, error: DepthErrorModel
) -> SystematicStd:
    """Return what a correlated error leaves of rotations about a point and of translations for any
    number of points.

    Over all three axes of each: the variance that the error causes, over the information of the
    points.
    """
    jacobian, _ = _jacobian(points_mm, normals, about_mm)
    seen = (jacobian**2).mean(axis=0)
    pulled = np.diag(
        _correlated_information(points_mm, jacobian, error.correlation_mm, _MAX_CORRELATED_DRAFT)
    )
    turn, shift = (
        float(pulled[k].sum() / max(seen[k].sum(), _NO_INFORMATION)) for k in (np.s_[:3], np.s_[3:])
    )
    return SystematicStd(
        translation_mm=error.rms_mm * math.sqrt(shift), rotation_mm=error.rms_mm * math.sqrt(turn)
    )


def _jacobian(points_mm: Doubles, normals: Doubles, about_mm: Doubles) -> tuple[Doubles, float]:
    """Return (n, 6) change of distances by scaled rotations and translations.

    And the rms distance (mm).
    """
    arms = points_mm - about_mm
    radius_mm = max(float(np.sqrt((arms**2).sum(axis=1).mean())), 1e-6)
    return np.concatenate([np.cross(arms, normals) / radius_mm, normals], axis=1), radius_mm


def _sum_products(a: Doubles, b: Doubles) -> Doubles:
    """Return a^T b, summed over the points in a fixed order; BLAS distributes it over threads."""
    return np.einsum("ni,nj->ij", a, b)


def _correlated_information(
    points_mm: Doubles, jacobian: Doubles, correlation_mm: float, most: int
) -> Doubles:
    """Return (6, 6) J^T C J / n^2 of correlated errors of 1 mm rms, from at most `most` of the
    points.
    """
    some = np.s_[:: -(-len(points_mm) // most)]
    places = (points_mm[some] - points_mm.mean(axis=0)) / correlation_mm
    half_sq = 0.5 * (places**2).sum(axis=1)
    together = places @ places.T
    together -= half_sq
    together -= half_sq[:, None]
    np.exp(together, out=together)
    pulls = _sum_products(together, jacobian[some])  # `together` is symmetric
    return _sum_products(jacobian[some], pulls) / len(together) ** 2


def _along_surface(arms: Doubles, information: Doubles) -> Doubles:
    """Return (6, 6) mean square motion of the points along the surface: everything but J^T J."""
    spread = _sum_products(arms, arms) / len(arms)
    middle = arms.mean(axis=0)
    carried = np.zeros((6, 6))
    carried[:3, :3] = np.trace(spread) * np.eye(3) - spread
    carried[3:, 3:] = np.eye(3)
    # (w x a) . t = w . (a x t)
    carried[:3, 3:] = rigid.cross_matrix(middle)
    carried[3:, :3] = carried[:3, 3:].T
    return carried - information


def _required_information(
    turn_mm2: float, shift_mm2: float, radius_mm: float, tolerances: Tolerances
) -> Doubles:
    """Return (6, 6) information at which the predicted standard deviation equals the tolerances."""
    turn_mm = math.radians(tolerances.deg) * radius_mm
    return np.diag([turn_mm2 / turn_mm**2] * 3 + [shift_mm2 / tolerances.mm**2] * 3)


def _find_undetermined(information: Doubles, required: Doubles) -> Doubles:
    """Return orthonormal (6, k): the motions v with v^T information v < v^T required v.

    Both sides are quadratic forms, so the result does not depend on the relative scale of rotations
    and translations.
    """
    # a contact of almost no extent needs a million times more for rotations
    size = 1.0 / np.sqrt(np.diag(required))
    values, vectors = np.linalg.eigh(required * np.outer(size, size))
    whiten = size[:, None] * vectors / np.sqrt(np.maximum(values, _NO_INFORMATION))
    seen, directions = np.linalg.eigh(whiten.T @ information @ whiten)
    weak = whiten @ directions[:, seen < 1.0]
    return np.linalg.qr(weak)[0] if weak.shape[1] else np.zeros((6, 0))


def _covariance(information: Doubles, projector: Doubles, variance_mm2: float) -> Doubles:
    """Return the covariance of a motion in scaled coordinates.

    Undetermined directions do not count.
    """
    true = projector @ information @ projector
    values, vectors = np.linalg.eigh(0.5 * (true + true.T))
    least = _NO_INFORMATION * float(np.trace(information))
    return (vectors * (variance_mm2 / np.maximum(values, least))) @ vectors.T


# standard error of a spread estimated by the median, times the root of the number of points
_MEDIAN_STD_ERROR = 1.16
_MIN_COSINE = 0.5  # cosine of contact and model normal above which both are one surface
_MIN_POINTS = 20  # points needed to assess observability
SYSTEMATIC_STD_MM = (
    # of all depths together: between nodes 0.1 mm apart a sphere of 5 mm radius sags by half of it
    0.0006
)


@frozen
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
