"""Select the pose among the minima, and those that fit equally well.

Describe what is not observable.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pipeline.core.arrays import Doubles, freeze
from pipeline.core.errors import StageWarning
from pipeline.core.geometry import rigid
from pipeline.core.geometry.screws import SLIDE_ROTATION_LIMIT, describe_direction
from pipeline.core.progress import SILENT, Progress
from pipeline.stages.pose.registration.observability import Observability
from pipeline.stages.pose.registration.ranking import PoseJudge, outline_constrains
from pipeline.stages.pose.registration.search import SAME_DEG, SAME_MM, PoseMinimum, PoseSearch

OUTLINE_ONLY = "determined only by the outline of the contact"
# share of a rotation's displacement of the centroid; a shorter translation is not described
_MIN_SHIFT_SHARE = 0.1
_OPEN = "looking for what the touch leaves open"
# share of the contact on the object below which expect a wrong pose; check mesh and calibration
_MIN_FITNESS = 0.5
# Of 90 simulated touches, measured or translated, six have their contact on the object and differ
# outside it by more than the depth's error: three wrong poses, and three right ones whose contacts
# lack a light part.
MISSING_CONTACT_WARNING = StageWarning(
    "at this pose the object would also touch outside the contact: expect a wrong pose, or a lost "
    "light contact"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class SelectedPose:
    """The selected minimum and its description."""

    minimum: PoseMinimum
    observability: Observability
    alternatives: tuple[Doubles, ...]  # (4, 4) each, best first
    notes: tuple[str, ...]


def select_pose(
    search: PoseSearch,
    found: Sequence[PoseMinimum],
    progress: Progress = SILENT,
    *,
    equal: Sequence[Doubles] | None = None,
) -> SelectedPose | None:
    """Select the first of `found`, which is in order.

    None if there is none. `progress` may cancel it. `equal` are the poses that fit as well, where
    they need not be looked for.
    """
    if not found:
        return None
    progress.step(1.0, _OPEN)
    first = found[0].fit.sensor_from_object
    known = search.assess_observability(first)
    known = replace(
        known, covariance=search.match(first).compute_covariance(search.middle_mm, known)
    )
    progress.step(1.0, _OPEN)
    shown = _shown_by_outline(search, first, known)
    unseen = known.weak_motions[[not s for s in shown]]
    others = equal
    if others is None:
        explained = search.explains(found[0])
        besides = [m.fit.sensor_from_object for m in found[1:]]
        others = search.find_equal_poses(first, besides, unseen, progress, explained=explained)
    chosen = _centre_on_contact(search, found[0], unseen, search.make_fine_judge())
    notes = tuple(
        f"{words}: {OUTLINE_ONLY}"
        if seen
        else StageWarning(f"{words}: {_describe_placement(words)}")
        for words, seen in zip(known.weak_directions, shown, strict=True)
    )
    return SelectedPose(
        minimum=chosen,
        observability=known,
        alternatives=tuple(freeze(pose) for pose in others),
        notes=(
            *notes,
            *_describe_alternatives(search, chosen, others),
            *_describe_fit(search, chosen),
        ),
    )


def find_unobservable_motions(search: PoseSearch, pose: Doubles) -> Doubles:
    """Return motions (k, 6) that neither surface nor outline determines."""
    known = search.assess_observability(pose)
    return known.weak_motions[[not shown for shown in _shown_by_outline(search, pose, known)]]


def _describe_placement(words: str) -> str:
    """Return how a motion that nothing determines was set."""
    done = "where the contact's middle is" if words.startswith("slides") else "as first guessed"
    return f"not observable, kept {done}"


def _shown_by_outline(search: PoseSearch, pose: Doubles, known: Observability) -> list[bool]:
    """Return which of the weak motions the contact's outline determines."""
    if not known.weak_directions:
        return []
    by = search.make_outline_judge(pose)
    return [outline_constrains(pose, motion, search.middle_mm, by) for motion in known.weak_motions]


def _centre_on_contact(
    search: PoseSearch, minimum: PoseMinimum, unseen: Doubles, by: PoseJudge
) -> PoseMinimum:
    """Move the object's centre toward the contact's along undetermined motions, as far as the
    misfit allows.
    """
    pose = minimum.fit.sensor_from_object
    before = minimum.fit
    for motion in unseen:
        length = float(np.linalg.norm(motion[3:]))
        if np.linalg.norm(motion[:3]) * search.points.radius_mm > SLIDE_ROTATION_LIMIT * length:
            continue
        along = motion[3:] / length
        far_mm = float(along @ (search.middle_mm - rigid.apply(pose, search.object.middle_mm)))
        slid = rigid.translation(*(far_mm * along)) @ pose
        if not by.distinguishes(pose, slid):
            pose = slid
    if pose is before.sensor_from_object:
        return minimum
    steps = (
        (*before.steps, replace(before.steps[-1], sensor_from_object=freeze(pose)))
        if before.steps
        else ()
    )
    stopped = (
        f"{before.stop_reason}; then moved along unobservable directions to the contact's centre"
    )
    return replace(
        minimum,
        fit=replace(before, sensor_from_object=freeze(pose), steps=steps, stop_reason=stopped),
    )


def _describe_alternatives(
    search: PoseSearch, chosen: PoseMinimum, others: Sequence[Doubles]
) -> tuple[str, ...]:
    if not others:
        return ()
    how = _describe_difference(search, chosen.fit.sensor_from_object, others[0])
    which = how if len(others) == 1 else f"the next one {how}"
    least = "" if search.explains(chosen) else "at least "
    return (StageWarning(f"{least}{len(others) + 1} poses fit equally well: {which}"),)


def _describe_difference(search: PoseSearch, a: Doubles, b: Doubles) -> str:
    relative = b @ rigid.invert(a)
    turn = rigid.rotation_vector_rad(relative)
    shift = rigid.apply(relative, search.middle_mm) - search.middle_mm
    angle_deg = float(np.rad2deg(np.linalg.norm(turn)))
    far_mm = float(np.linalg.norm(shift))
    words: list[str] = []
    if angle_deg > SAME_DEG:
        words.append(f"turned by {angle_deg:.0f} deg about {describe_direction(turn)}")
    if far_mm > max(SAME_MM, _MIN_SHIFT_SHARE * np.linalg.norm(turn) * search.points.radius_mm):
        words.append(f"shifted by {far_mm:.1f} mm along {describe_direction(shift)}")
    return " and ".join(words)


def _describe_fit(search: PoseSearch, chosen: PoseMinimum) -> tuple[str, ...]:
    fit = chosen.fit
    long_mm, contact_mm = (
        float(np.ptp(p, axis=0).max())
        for p in (search.object.model.points_mm, search.scene.points_mm)
    )
    if fit.fitness < _MIN_FITNESS and long_mm < contact_mm:
        text = (
            f"the object, {long_mm:.2g} mm long, is smaller than its contact "
            f"({contact_mm:.2g} mm); check the unit"
        )
        return (StageWarning(text),)
    if fit.fitness < _MIN_FITNESS:
        return (
            StageWarning(
                f"only {fit.fitness:.0%} of the contact lies on the object: expect a wrong pose; "
                "check the mesh"
            ),
        )
    if search.explains(chosen):
        return () if chosen.misfit_mm <= search.limit_mm else (MISSING_CONTACT_WARNING,)
    text = search.describe_misfit(fit.fitness, fit.rmse_mm)
    return (StageWarning(f"{text}; expect a wrong pose, or check the mesh"),)
