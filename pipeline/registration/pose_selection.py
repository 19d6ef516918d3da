"""From minima to an answer: the best, those that fit equally well, and in words what nothing shows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pipeline.base.arrays import Doubles, freeze
from pipeline.base.progress import SILENT, Progress
from pipeline.base.stage_warnings import StageWarning
from pipeline.geometry import rigid
from pipeline.geometry.screws import SLIDE_ROTATION_LIMIT, describe_direction
from pipeline.registration.observability import Observability
from pipeline.registration.outline import outline_constrains
from pipeline.registration.ranking import PoseJudge
from pipeline.registration.search import SAME_DEG, SAME_MM, PoseMinimum, PoseSearch

OUTLINE_ONLY = "seen only by the outline of the contact"
_ONE_PLACE = 0.1  # of the way a turn carries the contact's middle: so short a shift is not worth a word
_OPEN = "looking for what the touch leaves open"
_DOUBTFUL = 0.5  # share of the contact on the object
# Of 90 simulated touches, measured or translated, six have what was felt on the object and are beyond the depth's
# error for what was not: three wrong poses, and three right ones whose contacts lack a light part.
MISSING_CONTACT_WARNING = StageWarning(
    "the object would be felt beside the contact too if it lay so: the pose is doubtful, or a light part was lost"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class SelectedPose:
    """The chosen minimum and what goes with it."""

    minimum: PoseMinimum
    observability: Observability
    alternatives: tuple[Doubles, ...]  # (4, 4) each, best first
    notes: tuple[str, ...]


def select_pose(search: PoseSearch, found: Sequence[PoseMinimum], progress: Progress = SILENT) -> SelectedPose | None:
    """The first of the minima found, which are in order; None where there are none. Can be stopped by `progress`."""
    if not found:
        return None
    progress.step(1.0, _OPEN)
    first = found[0].fit.sensor_from_object
    known = search.assess_observability(first)
    known = replace(known, covariance=search.match(first).compute_covariance(search.middle_mm, known))
    progress.step(1.0, _OPEN)
    shown = _shown(search, first, known)
    unseen = known.weak_motions[[not s for s in shown]]
    explained = search.explains(found[0])
    others = search.find_equal_poses(
        first, [m.fit.sensor_from_object for m in found[1:]], unseen, progress, explained=explained
    )
    chosen = _in_the_middle(search, found[0], unseen, search.make_fine_judge())
    notes = tuple(
        f"{words}: {OUTLINE_ONLY}" if seen else StageWarning(f"{words}: {_kept(words)}")
        for words, seen in zip(known.weak_directions, shown, strict=True)
    )
    return SelectedPose(
        minimum=chosen, observability=known, alternatives=tuple(freeze(pose) for pose in others),
        notes=(*notes, *_about_others(search, chosen, others), *_about_fit(search, chosen)),
    )  # fmt: skip


def find_unobservable_motions(search: PoseSearch, pose: Doubles) -> Doubles:
    """Motions (k, 6) that neither the contact's surface nor its outline shows: poses that differ by them are one."""
    known = search.assess_observability(pose)
    return known.weak_motions[[not shown for shown in _shown(search, pose, known)]]


def _kept(words: str) -> str:
    """What was done about a motion that nothing shows."""
    done = "where the contact's middle is" if words.startswith("slides") else "as first guessed"
    return f"not observable, kept {done}"


def _shown(search: PoseSearch, pose: Doubles, known: Observability) -> list[bool]:
    """Which of the weak motions the outline of the contact shows after all."""
    if not known.weak_directions:
        return []
    by = search.make_outline_judge(pose)
    return [outline_constrains(pose, motion, search.middle_mm, by) for motion in known.weak_motions]


def _in_the_middle(search: PoseSearch, minimum: PoseMinimum, unseen: Doubles, by: PoseJudge) -> PoseMinimum:
    """Slid along what nothing shows, as far as nothing speaks against it: the object's middle to the contact's."""
    pose, before = minimum.fit.sensor_from_object, minimum.fit
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
    steps = (*before.steps, replace(before.steps[-1], sensor_from_object=freeze(pose))) if before.steps else ()
    stopped = f"{before.stop_reason}; then slid along what nothing shows, to the contact's middle"
    return replace(minimum, fit=replace(before, sensor_from_object=freeze(pose), steps=steps, stop_reason=stopped))


def _about_others(search: PoseSearch, chosen: PoseMinimum, others: Sequence[Doubles]) -> tuple[str, ...]:
    if not others:
        return ()
    how = _in_words(search, chosen.fit.sensor_from_object, others[0])
    which = how if len(others) == 1 else f"the next one {how}"
    least = "" if search.explains(chosen) else "at least "
    return (StageWarning(f"{least}{len(others) + 1} poses fit equally well: {which}"),)


def _in_words(search: PoseSearch, a: Doubles, b: Doubles) -> str:
    relative = b @ rigid.invert(a)
    turn = rigid.rotation_vector_rad(relative)
    shift = rigid.apply(relative, search.middle_mm) - search.middle_mm
    angle_deg, far_mm = float(np.rad2deg(np.linalg.norm(turn))), float(np.linalg.norm(shift))
    words: list[str] = []
    if angle_deg > SAME_DEG:
        words.append(f"turned by {angle_deg:.0f} deg about {describe_direction(turn)}")
    if far_mm > max(SAME_MM, _ONE_PLACE * np.linalg.norm(turn) * search.points.radius_mm):
        words.append(f"shifted by {far_mm:.1f} mm along {describe_direction(shift)}")
    return " and ".join(words)


def _about_fit(search: PoseSearch, chosen: PoseMinimum) -> tuple[str, ...]:
    fit = chosen.fit
    long_mm, felt_mm = (float(np.ptp(p, axis=0).max()) for p in (search.object.model.points_mm, search.scene.points_mm))
    if fit.fitness < _DOUBTFUL and long_mm < felt_mm:
        told = (
            f"the object, {long_mm:.2g} mm long, is smaller than its contact of {felt_mm:.2g} mm; check the mesh's unit"
        )
        return (StageWarning(told),)
    if fit.fitness < _DOUBTFUL:
        return (StageWarning(f"only {fit.fitness:.0%} of the contact lies on the object; the pose is doubtful"),)
    if search.explains(chosen):
        return () if chosen.misfit_mm <= search.limit_mm else (MISSING_CONTACT_WARNING,)
    told = (
        f"{fit.fitness:.0%} of the contact lies on the object, {fit.rmse_mm:.2g} mm off where the depth's error "
        f"makes up {search.limit_mm:.2g} mm; the pose, or the mesh, is doubtful"
    )
    return (StageWarning(told),)
