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
        tried = apply_screw(best, steps * size_mm, about_mm)
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
    trials = np.outer((0.0, _TRIAL_MM, -_TRIAL_MM), motion)
    here, one, other = by.misfit_mm(apply_screw(pose, trials, about_mm))
    return bool(min(one, other) > here * (1 + _NOTICED_SHARE) + _NOTICED_MM)


def apply_screw(pose: Doubles, motions: Doubles, about_mm: Doubles) -> Doubles:
    """Return `pose` (..., 4, 4) after screw motions (..., 6), rotation rad and translation mm, of the sensor frame.

    The full screw is followed, so a body of revolution rotated about its own axis stays in place at any distance.
    """
    vectors, shifts = motions[..., :3], motions[..., 3:]
    angles = np.linalg.norm(vectors, axis=-1, keepdims=True)
    safe = np.where(angles > _STRAIGHT_RAD, angles, 1.0)
    axes = np.where(angles > _STRAIGHT_RAD, vectors, 0.0) / safe
    across = np.cross(axes, shifts)
    bent = ((1 - np.cos(safe)) * across + (safe - np.sin(safe)) * np.cross(axes, across)) / safe
    turned = rigid.rotation(vectors)
    turned[..., :3, 3] = about_mm - turned[..., :3, :3] @ about_mm + shifts + bent
    return turned @ pose
