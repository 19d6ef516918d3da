"""Pose errors that ignore rotations mapping an object onto itself, and unobservable motions.

A symmetry is that of the whole object. One touch can be more symmetric: a hex key's shaft is a rod
while its elbow is out of view (BOP-Distrib). `compute_observable_error` covers that, touch by
touch.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pipeline.core.arrays import Doubles, freeze
from pipeline.core.derived import derive_once
from pipeline.core.geometry import rigid
from pipeline.core.geometry.meshes import Mesh

if TYPE_CHECKING:
    from pipeline.core.geometry.symmetry import Symmetry

SYMMETRY_STEP = 0.01  # of the diameter, between neighbouring turns about an axis
_FEW = 500  # vertices below which their convex hull is not worth its time
# vertices that rank the symmetries, and symmetries that are then looked at together
_ROUGH = 48
_AT_ONCE = 8
_GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0
_NARROWED = 24  # golden sections: to a hundred thousandth of the first bracket
_SMALL_RAD = 1e-4


@dataclass(frozen=True, slots=True, kw_only=True)
class SymmetricPoseError:
    """Errors of an estimate against the true pose."""

    mssd_mm: float  # largest displacement of a vertex, least over the symmetries
    se2_mm: float  # in the sensor plane, at the contact; for a body of revolution between the axes
    se2_deg: float  # about the sensor's optical axis; for a body of revolution between the axes
    # translation of the contact's centre along determined directions; NaN = unknown
    observable_mm: float
    observable_deg: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Ambiguity:
    """Poses that fit equally well."""

    n_distinct: int  # not mapped onto each other by a symmetry
    spread_mm: float  # largest MSSD between two of them


def compute_symmetric_error(
    estimate: Doubles,
    truth: Doubles,
    mesh: Mesh,
    symmetry: Symmetry | None,
    at_mm: Doubles,
    observable: Doubles | None = None,
) -> SymmetricPoseError:
    """Compute all errors of sensor_from_object (4, 4) at the contact's centre `at_mm` (3,) in the
    sensor frame.

    `symmetry` None = unknown: the object counts as asymmetric. `observable` is that of
    `ObjectPose`.
    """
    mssd, turn = _nearest(estimate, truth, compute_hull(mesh), symmetry)
    same = truth @ turn
    shift, angle = compute_in_plane_error(
        estimate, remove_axis_rotation(estimate, same, symmetry), symmetry, at_mm
    )
    seen = math.nan
    seen_angle = math.nan
    if observable is not None:
        seen, seen_angle = compute_observable_error(
            estimate, remove_axis_rotation(estimate, same, symmetry), observable, at_mm
        )
    return SymmetricPoseError(
        mssd_mm=mssd, se2_mm=shift, se2_deg=angle, observable_mm=seen, observable_deg=seen_angle
    )


def compute_in_plane_error(
    estimate: Doubles, truth: Doubles, symmetry: Symmetry | None, at_mm: Doubles
) -> tuple[float, float]:
    """Return (mm, deg) in the sensor's x-y plane, as in the paper, for a true pose already reduced
    by symmetry.

    The translation is that of the object's point at `at_mm`. A body of revolution is compared by
    its axis alone: translations along the axis count in the MSSD only.
    """
    motion = estimate @ rigid.invert(truth)
    shift = rigid.apply(motion, at_mm) - at_mm
    if symmetry is not None and symmetry.axis is not None:
        axis = estimate[:3, :3] @ symmetry.axis
        shift = shift - axis * (axis @ shift)
    turn_rad = rigid.rotation_vector_rad(motion)[2]
    return float(np.hypot(shift[0], shift[1])), abs(math.degrees(turn_rad))


def compute_observable_error(
    estimate: Doubles, truth: Doubles, observable: Doubles, at_mm: Doubles
) -> tuple[float, float]:
    """Return (mm, deg) of the motion from true pose to estimate within the determined directions.

    The motion is a screw about `at_mm` (the logarithm in SE(3)), so that a long translation and a
    full roll along a rod, about a ball or over a plate stay within their directions, which are
    closed under composition.
    """
    middle = rigid.translation(*at_mm)
    screw = _screw(rigid.invert(middle) @ estimate @ rigid.invert(truth) @ middle)
    seen = observable @ screw
    return float(np.linalg.norm(seen[3:])), math.degrees(float(np.linalg.norm(seen[:3])))


def compute_ambiguity(
    poses: Sequence[Doubles], mesh: Mesh, symmetry: Symmetry | None, same_mm: float
) -> Ambiguity:
    """Count the distinct poses of a registration: those within `same_mm` of MSSD of an earlier
    one count once.
    """
    corners = compute_hull(mesh)
    kept = list[Doubles]()
    spread = 0.0
    for pose in poses:
        apart = [_nearest(pose, other, corners, symmetry)[0] for other in kept]
        if all(mm > same_mm for mm in apart):
            kept.append(pose)
            spread = max([spread, *apart])
    return Ambiguity(n_distinct=len(kept), spread_mm=spread)


def compute_hull(mesh: Mesh) -> Doubles:
    """Return the vertices (n, 3) of the convex hull: displacement is convex, so its maximum is
    there.
    """
    return mesh.vertices_mm if len(mesh.vertices_mm) <= _FEW else _hull_of(mesh.vertices_mm)


@derive_once
def _hull_of(vertices_mm: Doubles) -> Doubles:
    from scipy.spatial import ConvexHull, QhullError

    try:
        return freeze(vertices_mm[ConvexHull(vertices_mm).vertices])
    except QhullError:  # a flat mesh has no hull
        return vertices_mm


def _nearest(
    estimate: Doubles, truth: Doubles, points: Doubles, symmetry: Symmetry | None
) -> tuple[float, Doubles]:
    """Return (least MSSD in mm, its symmetry (4, 4)).

    Maximum symmetry-aware surface distance of BOP: min over S of max over vertices x of |estimate x
    - truth S x|. A continuous symmetry is searched at steps of one percent of the diameter, and
    then between the steps.
    """
    if symmetry is None:
        return _farthest(estimate, truth, np.eye(3)[None], points)[0], np.eye(4)
    group = symmetry.sample_rotations(SYMMETRY_STEP)
    at_least = _farthest(estimate, truth, group, points[:: max(1, len(points) // _ROUGH)])
    best = math.inf
    turn = group[0]
    for part in np.array_split(
        np.argsort(at_least, kind="stable"), math.ceil(len(group) / _AT_ONCE)
    ):
        if at_least[part[0]] >= best:
            break
        all_mm = _farthest(estimate, truth, group[part], points)
        k = int(np.argmin(all_mm))
        best, turn = min((best, turn), (float(all_mm[k]), group[part[k]]), key=lambda each: each[0])
    if symmetry.axis is not None:
        best, turn = _between_steps(estimate, truth, points, turn, symmetry.axis, best)
    matrix = np.eye(4)
    matrix[:3, :3] = turn
    return best, matrix


def _farthest(estimate: Doubles, truth: Doubles, turns: Doubles, points: Doubles) -> Doubles:
    """Return (k,) largest displacement (mm) of a point, for each rotation (k, 3, 3) applied
    before the true pose.
    """
    difference = estimate[:3, :3] - truth[:3, :3] @ turns
    shift = estimate[:3, 3] - truth[:3, 3]
    return np.sqrt(((difference @ points.T + shift[:, None]) ** 2).sum(axis=1).max(axis=1))


def _between_steps(
    estimate: Doubles, truth: Doubles, points: Doubles, turn: Doubles, axis: Doubles, best: float
) -> tuple[float, Doubles]:
    """Return the least MSSD near `turn` by golden section over one step either way."""

    def at(angle: float) -> tuple[float, Doubles]:
        turned = turn @ rigid.rotation(angle * axis)[:3, :3]
        return float(_farthest(estimate, truth, turned[None], points)[0]), turned

    low = -2.0 * SYMMETRY_STEP
    high = 2.0 * SYMMETRY_STEP
    found = (best, turn)
    for _ in range(_NARROWED):
        left = at(high - _GOLDEN * (high - low))
        right = at(low + _GOLDEN * (high - low))
        if left[0] < right[0]:
            high = low + _GOLDEN * (high - low)
        else:
            low = high - _GOLDEN * (high - low)
        found = min(found, left, right, key=lambda each: each[0])
    return found


def remove_axis_rotation(estimate: Doubles, truth: Doubles, symmetry: Symmetry | None) -> Doubles:
    """Return the true pose after the rotation about the symmetry axis that minimises the error
    (swing and twist).
    """
    if symmetry is None or symmetry.axis is None:
        return truth
    between = truth[:3, :3].T @ estimate[:3, :3]
    # cos and sin of the twist, both times one positive number.
    along = symmetry.axis @ np.array(
        [
            between[2, 1] - between[1, 2],
            between[0, 2] - between[2, 0],
            between[1, 0] - between[0, 1],
        ]
    )
    twist = math.atan2(
        along, float(np.trace(between)) - float(symmetry.axis @ between @ symmetry.axis)
    )
    return truth @ rigid.rotation(twist * symmetry.axis)


def _screw(motion: Doubles) -> Doubles:
    """Return the logarithm (6,) of a rigid motion: rotation vector, and translation per unit of
    the motion along it.
    """
    turn = rigid.rotation_vector_rad(motion)
    angle = float(np.linalg.norm(turn))
    skew = rigid.cross_matrix(turn)
    curl = (
        1.0 / 12.0 if angle < _SMALL_RAD else (1.0 - 0.5 * angle / math.tan(0.5 * angle)) / angle**2
    )
    return np.concatenate([turn, (np.eye(3) - 0.5 * skew + curl * (skew @ skew)) @ motion[:3, 3]])
