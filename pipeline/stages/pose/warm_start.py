"""Follow an object from touch to touch: the pose of the last one is the start of the next, and the
poses that fitted it as well move along.

Where the object has jumped, no longer explains the contact, or another pose has come to fit
better, there is no answer and a search is due.
"""

from collections.abc import Sequence

import numpy as np

from pipeline.core.arrays import Doubles
from pipeline.core.geometry import rigid
from pipeline.core.progress import SILENT, Progress
from pipeline.core.values.results import ObjectPose
from pipeline.stages.pose.registration.search import (
    SAME_MM,
    PoseMinimum,
    PoseSearch,
    SelectedPose,
    select_pose,
)

FOLLOWED = "followed from the pose of the previous touch, without a search"
_SETTLED_MM = 0.01  # of a last registration's motion at the contact
_MAX_REGISTRATIONS = 4
_WORSE = 1.1  # by which fitness and rms distance may be worse than at the last touch
_MAX_STEP_MM = SAME_MM  # at the contact, from touch to touch; a larger one is a jump


def follow_pose(
    search: PoseSearch, previous: ObjectPose, progress: Progress = SILENT
) -> SelectedPose | None:
    """Return the pose registered from the `previous` one; None where a search is due."""
    before = previous.sensor_from_object
    if before is None:
        return None
    minimum = _settle(search, search.register_roughly(before[None])[0])
    if (
        minimum is None
        or not _fits(search, minimum, previous)
        or search.measure_distance_mm(before, minimum.fit.sensor_from_object) > _MAX_STEP_MM
    ):
        return None
    pose = minimum.fit.sensor_from_object
    equal = move_along(search, previous.alternatives, before, pose)
    return None if equal is None else select_pose(search, [minimum], progress, equal=equal)


def _fits(search: PoseSearch, minimum: PoseMinimum, previous: ObjectPose) -> bool:
    """Return whether a pose explains the touch, or does so as well as the best that a search found
    for the last one.
    """
    fit = minimum.fit
    if search.explains(minimum) and minimum.misfit_mm <= search.limit_mm:
        return True
    return fit.fitness >= previous.fitness / _WORSE and fit.rmse_mm <= _WORSE * previous.rmse_mm


def _settle(search: PoseSearch, pose: Doubles) -> PoseMinimum | None:
    """Return the minimum that registrations from `pose` end in; None where one fails.

    A single one holds what the touch hardly determines as it was, and settles all else.
    """
    minimum: PoseMinimum | None = None
    for _ in range(_MAX_REGISTRATIONS):
        known = search.assess_observability(pose)
        minimum = search.polish(pose, dense=True, known=known)
        if minimum is None:
            return None
        moved_mm = search.measure_distance_mm(pose, minimum.fit.sensor_from_object)
        pose = minimum.fit.sensor_from_object
        if moved_mm <= _SETTLED_MM or not len(known.weak_motions):
            break
    return minimum


def move_along(
    search: PoseSearch, others: Sequence[Doubles], before: Doubles, pose: Doubles
) -> list[Doubles] | None:
    """Return the other poses after the same motion, as far as they still fit as well.

    None where one fits better.
    """
    if not others:
        return []
    judge = search.fine
    motion = pose @ rigid.invert(before)
    moved = [motion @ other for other in others]
    misfits_mm = judge.misfit_mm([pose, *moved])
    apart = [judge.distinguishes(pose, other) for other in moved]
    if np.any(apart & (misfits_mm[1:] < misfits_mm[0])):
        return None
    return [other for other, differs in zip(moved, apart, strict=True) if not differs]
