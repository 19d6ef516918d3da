"""How often the motions that a contact does not show are named, and how often others are.

Not a question itself.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.scenes.observability_patches import BAND, SAME_DEG, Patch
from pipeline.core.arrays import Doubles
from pipeline.stages.pose.registration.observability import Tolerances


@dataclass(frozen=True, slots=True, kw_only=True)
class ObservabilityScore:
    """Directions of one or many patches."""

    n_weak: int = 0  # truly unobservable
    n_named: int = 0  # of these, stated as such
    n_false: int = 0  # stated as unobservable, and well determined
    n_between: int = 0  # too close to the limit to be scored

    def __add__(self, other: ObservabilityScore) -> ObservabilityScore:
        return ObservabilityScore(
            n_weak=self.n_weak + other.n_weak,
            n_named=self.n_named + other.n_named,
            n_false=self.n_false + other.n_false,
            n_between=self.n_between + other.n_between,
        )

    @property
    def recall(self) -> float:
        """Share of the unobservable directions that were named; 1 where there are none."""
        return self.n_named / self.n_weak if self.n_weak else 1.0

    @property
    def precision(self) -> float:
        """Share of the named directions that are unobservable; 1 where none was named."""
        named = self.n_named + self.n_false
        return self.n_named / named if named else 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class TrueMotions:
    """What is true of a patch, in coordinates scaled by its radius about its centroid."""

    weak: Doubles  # (6, k) orthonormal: free by geometry, or seen BAND times less than asked for
    # (6, 6) takes a motion to its part that is seen BAND times more than asked for
    determined_part: Doubles
    n_determined: int
    centroid_mm: Doubles  # (3,)
    radius_mm: float


def compute_true_motions(
    dense: Patch, n_eff: float, sigma_mm: float, tolerances: Tolerances
) -> TrueMotions:
    """The truth about a patch from many exact points of it.

    Asked for is that the predicted standard deviation lies within the tolerances, and that the
    normals show more of a motion than a surface with the tolerated error of its normals would show
    of any.
    """
    centroid = dense.points_mm.mean(axis=0)
    arms = dense.points_mm - centroid
    radius = float(np.sqrt((arms**2).sum(axis=1).mean()))
    free = dense.free.copy()
    free[:, 3:] += np.cross(free[:, :3], centroid)  # translation at the centroid
    free[:, :3] *= radius
    structural = _orthonormal(free.T)
    rest = (
        np.linalg.svd(structural, full_matrices=True)[0][:, structural.shape[1] :]
        if free.size
        else np.eye(6)
    )
    seen, along = _seen_and_along(arms / radius, dense.normals)
    spread = np.array([math.radians(tolerances.deg) * radius] * 3 + [tolerances.mm] * 3)
    fake = along * math.radians(tolerances.normal_error_deg) ** 2
    asked = rest.T @ (fake + np.diag(sigma_mm**2 / n_eff / spread**2)) @ rest
    lower = np.linalg.inv(np.linalg.cholesky(asked))
    ratio, directions = np.linalg.eigh(lower @ (rest.T @ seen @ rest) @ lower.T)
    directions = rest @ (lower.T @ directions)
    basis = np.concatenate([structural, directions], axis=1)
    counts = ratio > BAND**2
    # What is between the limits is square to what is determined in the sense of what is seen, not
    # of lengths.
    kept = np.concatenate([np.zeros(structural.shape[1]), counts])
    return TrueMotions(
        weak=_orthonormal(np.concatenate([structural, directions[:, ratio < BAND**-2]], axis=1)),
        determined_part=(basis * kept) @ np.linalg.inv(basis),
        n_determined=int(counts.sum()),
        centroid_mm=centroid,
        radius_mm=radius,
    )


def _seen_and_along(arms: Doubles, normals: Doubles) -> tuple[Doubles, Doubles]:
    """(6, 6) mean squares of what a motion moves the points along their normals, and along the
    surface.
    """
    carried = np.concatenate(
        [-_crosses(arms), np.broadcast_to(np.eye(3), (len(arms), 3, 3))], axis=2
    )
    seen = np.einsum("nij,ni->nj", carried, normals)
    along = carried - normals[:, :, None] * seen[:, None, :]
    return seen.T @ seen / len(arms), np.einsum("nij,nik->jk", along, along) / len(arms)


def score_named_motions(
    weak_motions: Doubles, about_mm: Doubles, truth: TrueMotions
) -> ObservabilityScore:
    """Score the motions (k, 6) of (rotation rad, translation mm at `about_mm`) that were stated
    as unobservable.
    """
    motions = weak_motions.copy()
    motions[:, 3:] += np.cross(motions[:, :3], truth.centroid_mm - about_mm)
    motions[:, :3] *= truth.radius_mm
    named = _orthonormal(motions.T)
    limit = math.radians(SAME_DEG)
    return ObservabilityScore(
        n_weak=truth.weak.shape[1],
        n_named=_count(truth.weak.T @ named, math.cos(limit)),
        n_false=_count(truth.determined_part @ named, math.sin(limit)),
        n_between=6 - truth.weak.shape[1] - truth.n_determined,
    )


def _count(product: Doubles, least: float) -> int:
    """Principal directions whose share is above `least`."""
    return int((np.linalg.svd(product, compute_uv=False) > least).sum()) if product.size else 0


def _orthonormal(columns: NDArray[np.floating]) -> Doubles:
    return (
        np.asarray(np.linalg.qr(columns)[0], dtype=np.float64)
        if columns.shape[1]
        else np.zeros((6, 0))
    )


def _crosses(w: Doubles) -> Doubles:
    out = np.zeros((len(w), 3, 3))
    out[:, 0, 1], out[:, 0, 2], out[:, 1, 2] = -w[:, 2], w[:, 1], -w[:, 0]
    out[:, 1, 0], out[:, 2, 0], out[:, 2, 1] = w[:, 2], -w[:, 1], w[:, 0]
    return out
