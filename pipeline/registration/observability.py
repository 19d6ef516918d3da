"""How well a contact determines a pose, and which motions it does not see at all.

J_i = [((x_i - c) x n_i)^T, n_i^T] is what a small motion (rotation about the scene's centroid c, translation) changes
in the distance of point i along its normal; Cov = sigma^2 (J^T J)^-1 (valid for point-to-plane, Bonnabel 2014).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.arrays import Doubles

WEAK_SHARE = 0.03  # mm of change along the normals, rms, per mm of motion: less is drowned by compliance and sampling
WEAK_STD_MM = 0.2  # predicted spread of a direction beyond which the answer says nothing
MIN_NOISE_MM = 1e-3  # of a tactile depth; keeps a perfect fit from claiming certainty
_AXES = ("x", "y", "z")
_PURE = 0.9  # share of a direction that earns it a simple name


@dataclass(frozen=True, slots=True, kw_only=True)
class Observability:
    """What the data determine, about the scene's centroid, in the sensor frame."""

    covariance: Doubles  # (6, 6) of (rotation rad, translation mm); large, never infinite, where nothing is determined
    observable: Doubles  # (6, 6) idempotent: takes a motion to the part that the data determine
    weak: tuple[str, ...]  # what is left, in words
    weak_motions: Doubles  # (k, 6) of (rotation rad, translation mm) that go with them, each of 1 mm rms


def observability(points_mm: Doubles, normals: Doubles, about_mm: Doubles, noise_mm: float) -> Observability:
    """From matched points (n, 3) with the object's normals there, the scene's centroid, and the spread of residuals.

    Rotations are scaled by the points' rms distance from it, so that all six directions are in mm (methods 5.3).
    """
    arms = points_mm - about_mm
    radius_mm = max(float(np.sqrt((arms**2).sum(axis=1).mean())), 1e-6)
    jacobian = np.concatenate([np.cross(arms, normals) / radius_mm, normals], axis=1)
    n = len(points_mm)
    share_sq, directions = np.linalg.eigh(jacobian.T @ jacobian / n)
    share_sq = np.maximum(share_sq, 1e-9 * share_sq.sum())
    sigma_mm = max(noise_mm, MIN_NOISE_MM)
    variance = sigma_mm**2 / (share_sq * n)
    weak = (share_sq < WEAK_SHARE**2) | (variance > WEAK_STD_MM**2)
    to_mm = np.array([radius_mm] * 3 + [1.0] * 3)  # (rad, mm) -> mm
    lost = directions[:, weak]
    projector = np.eye(6) - lost @ lost.T
    named = in_words(lost)
    return Observability(
        covariance=(directions * variance) @ directions.T / np.outer(to_mm, to_mm),
        observable=projector * to_mm[None, :] / to_mm[:, None],
        weak=tuple(words for words, _ in named),
        weak_motions=np.array([motion / to_mm for _, motion in named]).reshape(-1, 6),
    )


def in_words(lost: Doubles) -> list[tuple[str, Doubles]]:
    """Named directions that span the orthonormal columns (6, k): plain axes first, mixtures for what remains."""
    named: list[tuple[str, Doubles]] = []
    order = (3, 4, 5, 0, 1, 2)  # slides before turns
    rest = lost
    for axis in sorted(order, key=lambda k: (-round(float((lost[k] ** 2).sum()), 3), order.index(k))):
        if rest.shape[1] and float(np.linalg.norm(rest[axis])) > _PURE:
            closest = rest @ rest[axis] / np.linalg.norm(rest[axis])
            named.append((f"slides along {_AXES[axis - 3]}" if axis >= 3 else f"turns about {_AXES[axis]}", closest))
            rest = _without(rest, axis)
    return [*named, *((_mixture(rest[:, k]), rest[:, k]) for k in range(rest.shape[1]))]


def _without(basis: Doubles, axis: int) -> Doubles:
    """The directions of `basis` at right angles to its closest match of one axis."""
    closest = basis.T @ np.eye(6)[axis]
    kept = np.linalg.svd(closest[None, :])[2][1:]
    return basis @ kept.T


def _mixture(direction: Doubles) -> str:
    turn, slide = direction[:3], direction[3:]
    if np.linalg.norm(slide) > _PURE:
        return f"slides along {_axis(slide)}"
    if np.linalg.norm(turn) > _PURE:
        return f"turns about {_axis(turn)}"
    return f"turns about {_axis(turn)} while sliding along {_axis(slide)}"


def _axis(vector: Doubles) -> str:
    unit = vector / np.linalg.norm(vector)
    k = int(np.argmax(np.abs(unit)))
    if abs(unit[k]) > _PURE:
        return _AXES[k]
    unit = unit * np.sign(unit[k])
    return "({:.2f}, {:.2f}, {:.2f})".format(*unit)
