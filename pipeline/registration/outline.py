"""Place an object along directions that its surface does not determine, by the contact's outline."""

from __future__ import annotations

import numpy as np

from pipeline.base.arrays import Doubles
from pipeline.geometry import rigid
from pipeline.registration.ranking import PoseJudge

_FIRST_STEP_MM, _LAST_STEP_MM = 0.8, 0.02
_MAX_ROUNDS = 40
_TRIAL_MM = 0.5  # translation (mm) that must raise the misfit for the outline to determine the place
_STRAIGHT_RAD = 1e-9  # a smaller rotation is a translation within rounding
_NOTICED_SHARE, _NOTICED_MM = 0.05, 0.01  # rise of the misfit that counts: share, and mm


def align_to_outline(pose: Doubles, weak_motions: Doubles, about_mm: Doubles, by: PoseJudge) -> Doubles:
    """Return `pose` moved along the weak motions (k, 6) to the least misfit, by pattern search with step halving."""
    if len(weak_motions) == 0:
        return pose
    steps = np.concatenate([weak_motions, -weak_motions])
    best, least = pose, float(by.misfit_mm([pose])[0])
    size_mm = _FIRST_STEP_MM
    for _round in range(_MAX_ROUNDS):
        tried = [apply_screw(best, step * size_mm, about_mm) for step in steps]
        misfits = by.misfit_mm(tried)
        k = int(np.argmin(misfits))
        if misfits[k] < least:
            best, least = tried[k], float(misfits[k])
            continue
        size_mm /= 2
        if size_mm < _LAST_STEP_MM:
            break
    return best


def outline_constrains(pose: Doubles, motion: Doubles, about_mm: Doubles, by: PoseJudge) -> bool:
    """Return whether the outline determines the place along one motion (6,): moving either way fits worse."""
    here, one, other = by.misfit_mm([apply_screw(pose, motion * s, about_mm) for s in (0.0, _TRIAL_MM, -_TRIAL_MM)])
    return bool(min(one, other) > here * (1 + _NOTICED_SHARE) + _NOTICED_MM)


def apply_screw(pose: Doubles, motion: Doubles, about_mm: Doubles) -> Doubles:
    """Return `pose` after a screw motion (rotation rad, translation mm at a point) of the sensor frame.

    The full screw is followed, so a body of revolution rotated about its own axis stays in place at any distance.
    """
    angle = float(np.linalg.norm(motion[:3]))
    turned, shift = rigid.rotation(motion[:3]), motion[3:]
    if angle > _STRAIGHT_RAD:
        axis = motion[:3] / angle
        across = _cross(axis, shift)
        shift = shift + ((1 - np.cos(angle)) * across + (angle - np.sin(angle)) * _cross(axis, across)) / angle
    turned[:3, 3] = about_mm - turned[:3, :3] @ about_mm + shift
    return turned @ pose


def _cross(a: Doubles, b: Doubles) -> Doubles:
    """Cross product of two vectors (3,): ten times faster than numpy's for single vectors."""
    (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])
