"""How well a contact determines a pose, and which motions it does not see at all.

J_i = [((x_i - c) x n_i)^T, n_i^T] is what a small motion (rotation about the scene's centroid c, translation) changes
in the distance of point i along its normal; Cov = sigma^2 (J^T J)^-1 (valid for point-to-plane, Bonnabel 2014), with
as many points as are independent of each other, and with an error that no number of points averages away.

What J^T J holds is not all true: a round rod is drawn with facets and a distance grid has crooked gradients, and
normals that are off by an angle e seem to see e^2 of every motion along the surface. So a direction counts as
determined only where more is seen of it than that, and enough to place it within a tolerance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pipeline.base.arrays import Doubles
from pipeline.geometry.screws import describe_motions
from pipeline.values.results import DepthErrorModel

MIN_NOISE_MM = 1e-3  # of a tactile depth; keeps a perfect fit from claiming certainty
NORMAL_ERROR_DEG = 3.0
"""rms, in each of two directions, of what a mesh and its distance grid say.

Facets that leave a round part of 1 mm radius by 2 um are off by 2 degrees, and errors that hang together over a patch
exceed their mean. It is also where an offset of all depths by 10 um shifts the answer by 0.2 mm: less slope is no hold.
"""
_MOST_PAIRED, _FEW_PAIRED = 500, 150  # points whose errors are compared with each other's: for good, and on the way
_NOTHING = 1e-9  # share of the information that stands for none, so that no variance is infinite


@dataclass(frozen=True, slots=True, kw_only=True)
class Tolerances:
    """What must be known of a motion for it to count as determined."""

    mm: float = 0.2  # predicted standard deviation of a shift of the contact's middle
    deg: float = 1.0  # of a turn about it
    normal_error_deg: float = NORMAL_ERROR_DEG  # of the model's normals


TOLERANCES = Tolerances()


@dataclass(frozen=True, slots=True, kw_only=True)
class SystematicStd:
    """Errors that no number of points averages away.

    A turn feels of a smooth error what differs across the contact, a shift what does not.
    """

    translation_mm: float = 0.0
    rotation_mm: float = 0.0  # at the points' rms distance from the middle


NO_SYSTEMATIC_STD = SystematicStd()


@dataclass(frozen=True, slots=True, kw_only=True)
class Observability:
    """What the data determine, about the scene's centroid, in the sensor frame."""

    covariance: Doubles  # (6, 6) of (rotation rad, translation mm); large, never infinite, where nothing is determined
    observable: Doubles  # (6, 6) idempotent: takes a motion to the part that the data determine
    weak_directions: tuple[str, ...]  # what is left, in words
    weak_motions: Doubles  # (k, 6) of (rotation rad, translation mm) that go with them, each of 1 mm rms
    systematic_error: SystematicStd = NO_SYSTEMATIC_STD
    tolerances: Tolerances = TOLERANCES  # that they were asked with


def assess_observability(
    points_mm: Doubles,
    normals: Doubles,
    about_mm: Doubles,
    noise_mm: float,
    *,
    lasting: SystematicStd = NO_SYSTEMATIC_STD,
    tolerances: Tolerances = TOLERANCES,
) -> Observability:
    """From matched points (n, 3) with the object's normals there, the scene's centroid, and the spread of residuals.

    `lasting` is the error that more of the points would not make smaller. Rotations are scaled by the points' rms
    distance from the centroid, so that all six directions are in mm.
    """
    arms = points_mm - about_mm
    jacobian, radius_mm = _jacobian(points_mm, normals, about_mm)
    information = jacobian.T @ jacobian / len(points_mm)
    alone = max(noise_mm, MIN_NOISE_MM) ** 2 / len(points_mm)
    shift_mm2, turn_mm2 = alone + lasting.translation_mm**2, alone + lasting.rotation_mm**2
    fake = _along_surface(arms / radius_mm, information) * math.radians(tolerances.normal_error_deg) ** 2
    asked = fake + _allowed(turn_mm2, shift_mm2, radius_mm, tolerances)
    lost = _undetermined(information, asked)
    to_mm = np.array([radius_mm] * 3 + [1.0] * 3)  # (rad, mm) -> mm
    projector = np.eye(6) - lost @ lost.T
    named = describe_motions(
        lost, np.asarray(about_mm, dtype=np.float64), radius_mm, lambda v: bool(v @ (information - asked) @ v < 0.0)
    )
    return Observability(
        covariance=_covariance(information, projector, max(turn_mm2, shift_mm2)) / np.outer(to_mm, to_mm),
        observable=projector * to_mm[None, :] / to_mm[:, None],
        weak_directions=tuple(words for words, _ in named),
        weak_motions=np.array([motion / to_mm for _, motion in named]).reshape(-1, 6),
        systematic_error=lasting,
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
    lasting_mm: float = 0.0,
) -> Doubles:
    """(6, 6) covariance of (rotation rad, translation mm) of the `observable` motions, by errors that go together.

    (J^T J)^-1 J^T C J (J^T J)^-1: C is that of single points' noise, of `error`, which is rms^2 exp(-d^2 / (2 l^2))
    between points d apart, and of what no number of points averages away.
    """
    jacobian, radius_mm = _jacobian(points_mm, normals, about_mm)
    to_mm = np.array([radius_mm] * 3 + [1.0] * 3)
    pulls = _pulls(points_mm, jacobian, error.correlation_mm, _MOST_PAIRED)
    projector = observable * to_mm[:, None] / to_mm[None, :]
    whole = _covariance(jacobian.T @ jacobian / len(points_mm), projector, 1.0)
    known = projector @ whole @ projector
    alone, shape = max(noise_mm, MIN_NOISE_MM) ** 2 / len(points_mm) + lasting_mm**2, error.rms_mm**2
    found = alone * known + shape * known @ pulls @ known + (alone + shape) * (whole - known)
    return 0.5 * (found + found.T) / np.outer(to_mm, to_mm)


def estimate_systematic_error(
    points_mm: Doubles, normals: Doubles, about_mm: Doubles, error: DepthErrorModel
) -> SystematicStd:
    """What an error that hangs together leaves of turns about a point, and of shifts, however many points there are.

    Over all three of each: the variance that the error gives the pulls on them, over what the points see of them.
    """
    jacobian, _ = _jacobian(points_mm, normals, about_mm)
    seen = (jacobian**2).mean(axis=0)
    pulled = np.diag(_pulls(points_mm, jacobian, error.correlation_mm, _FEW_PAIRED))
    turn, shift = (float(pulled[k].sum() / max(seen[k].sum(), _NOTHING)) for k in (np.s_[:3], np.s_[3:]))
    return SystematicStd(translation_mm=error.rms_mm * math.sqrt(shift), rotation_mm=error.rms_mm * math.sqrt(turn))


def _jacobian(points_mm: Doubles, normals: Doubles, about_mm: Doubles) -> tuple[Doubles, float]:
    """(n, 6) change of every distance by turns, scaled by the points' rms distance in mm, and by shifts; and that."""
    arms = points_mm - about_mm
    radius_mm = max(float(np.sqrt((arms**2).sum(axis=1).mean())), 1e-6)
    return np.concatenate([np.cross(arms, normals) / radius_mm, normals], axis=1), radius_mm


def _pulls(points_mm: Doubles, jacobian: Doubles, correlation_mm: float, most: int) -> Doubles:
    """(6, 6) J^T C J / n^2 of errors of 1 mm rms that hang together, by at most so many of the points."""
    some = np.s_[:: -(-len(points_mm) // most)]
    apart_sq = ((points_mm[some][:, None] - points_mm[some][None]) ** 2).sum(axis=-1)
    together = np.exp(apart_sq * (-0.5 / correlation_mm**2))
    return jacobian[some].T @ together @ jacobian[some] / len(together) ** 2


def _along_surface(arms: Doubles, information: Doubles) -> Doubles:
    """(6, 6) mean square of how far a motion carries the points along the surface: all of it but J^T J."""
    spread = arms.T @ arms / len(arms)
    middle = arms.mean(axis=0)
    carried = np.zeros((6, 6))
    carried[:3, :3] = np.trace(spread) * np.eye(3) - spread
    carried[3:, 3:] = np.eye(3)
    # (w x a) . t = w . (a x t)
    carried[:3, 3:] = np.array([[0.0, -middle[2], middle[1]], [middle[2], 0.0, -middle[0]], [-middle[1], middle[0], 0]])
    carried[3:, :3] = carried[:3, 3:].T
    return carried - information


def _allowed(turn_mm2: float, shift_mm2: float, radius_mm: float, tolerances: Tolerances) -> Doubles:
    """(6, 6) information below which the standard deviation that these variances predict exceeds the tolerances."""
    turn_mm = math.radians(tolerances.deg) * radius_mm
    return np.diag([turn_mm2 / turn_mm**2] * 3 + [shift_mm2 / tolerances.mm**2] * 3)


def _undetermined(information: Doubles, asked: Doubles) -> Doubles:
    """Orthonormal (6, k): the motions v with v^T information v < v^T asked v.

    Both sides are forms, so that the answer does not depend on how turns are weighed against shifts.
    """
    size = 1.0 / np.sqrt(np.diag(asked))  # a contact of almost no extent asks a million times more of turns
    values, vectors = np.linalg.eigh(asked * np.outer(size, size))
    whiten = size[:, None] * vectors / np.sqrt(np.maximum(values, _NOTHING))
    seen, directions = np.linalg.eigh(whiten.T @ information @ whiten)
    weak = whiten @ directions[:, seen < 1.0]
    return np.linalg.qr(weak)[0] if weak.shape[1] else np.zeros((6, 0))


def _covariance(information: Doubles, projector: Doubles, variance_mm2: float) -> Doubles:
    """Of a motion in scaled coordinates; what an undetermined direction seems to show does not count."""
    true = projector @ information @ projector
    values, vectors = np.linalg.eigh(0.5 * (true + true.T))
    least = _NOTHING * float(np.trace(information))
    return (vectors * (variance_mm2 / np.maximum(values, least))) @ vectors.T
