"""Search for the poses at which an object explains a touch.

Many initial poses are ranked, the best registered, distinct minima kept. Ranking uses contact and
free space; each step is more exact on fewer poses.

Select the pose among the minima, and those that fit equally well.

Describe what is not observable.
"""

import math
from collections.abc import Sequence
from dataclasses import field, replace
from itertools import permutations, product

import numpy as np

from pipeline.core.arrays import Doubles, freeze
from pipeline.core.errors import StageWarning
from pipeline.core.frozen import frozen
from pipeline.core.geometry import rigid
from pipeline.core.geometry.screws import SLIDE_ROTATION_LIMIT, describe_direction
from pipeline.core.progress import SILENT, Progress
from pipeline.core.values.results import PoseStep
from pipeline.stages.pose.registration.gauss_newton import (
    CentredPoints,
    FitOptions,
    NotDetermined,
    PoseFit,
    fit_pose,
    register_from_starts,
    trace_iterations,
)
from pipeline.stages.pose.registration.model import ObjectModel, PreparedObject
from pipeline.stages.pose.registration.observability import (
    NORMAL_ERROR_DEG,
    MatchedPoints,
    Observability,
    Tolerances,
    match_points,
)
from pipeline.stages.pose.registration.ranking import (
    LEAST_SPREAD_MM,
    PoseJudge,
    align_to_outline,
    make_judge,
    outline_constrains,
)
from pipeline.stages.pose.registration.scene import ContactScene, InitialPose, find_in_reach

# On gels, half or double of any count finds no more poses and saves little time:
# docs/experiments.md, search_counts. points to rank initial poses: at least, at most
_COARSE_CONTACT = 50
_COARSE_MODEL = (500, 4000)
_COARSE_MM2 = 1.0  # object surface per point
# points to rank where these converge
_MIDDLE_CONTACT = 150
_MIDDLE_MODEL = 1500
# points to rank the results
_FINE_CONTACT = 750
_FINE_MODEL = 15_000
# points to place it by the outline
_OUTLINE_CONTACT = 200
_OUTLINE_MODEL = 1000
_POLISH_POINTS = 500  # points to register it, before all points are used
# the same for the best ones
_DENSE_CONTACT = 400
_DENSE_MODEL = 4000
_PER_GROUP = 2
_N_POLISHED = 6
_N_DENSE = 2
# of all orientations: a wide contact that is nearly right fits no better than a wrong one
_N_REGISTERED = 144
_QUICK_POINTS = 100
_QUICK_ITERATIONS = 10
_QUICK_SETTLED_MM = 0.02
_GAIN = 0.95  # ratio of misfits above which a registration has converged
_POLISHED_SHARE = 4.0  # the last registration's search distance is this many times smaller
_OUTLINE_REACH_MM = 4.0  # object this far around the contact may touch outside it
_MIN_FITNESS = 0.8  # share of the contact on an object that explains it
_FAR = 3.0  # standard deviations
_NEAR = 2.0  # factor on the best misfit up to which a few points may show an equal pose
# iterations and number of equal poses; all rotations of a cube but one
_MAX_ITERATIONS = 3
_MAX_EQUAL = 23
# rotations tried for equal poses: a cube's; where nothing explains the touch
_MAX_ROTATED = 72
_MAX_ROTATED_DRAFT = 12
_FACETS_REACH_MM = 0.5  # around the contact
_BENT_SQ = 0.005  # squared sine of half an edge's angle; the grid errs by less on round surfaces
_CORRELATED = 1.5  # facet errors are correlated over a contact: ratio of their mean to their rms
_STRAIGHT_DEG = (
    # error of the grid's gradients on a flat face
    # (tests/pipeline/core/geometry/test_distance_grid.py: 0.3)
    0.5
)
# poses this close are one
SAME_MM = 1.0
SAME_DEG = 5.0


_TURNED_OVER = tuple(
    turn
    for axes in permutations(range(3))
    for signs in product((1.0, -1.0), repeat=3)
    if np.linalg.det(turn := np.eye(3)[list(axes)] * signs) > 0
    and not np.array_equal(turn, np.eye(3))
)
"""The 23 turns that take the axes of an object to themselves."""


@frozen
class PoseMinimum:
    """A pose at which a registration converged."""

    fit: PoseFit
    misfit_mm: float


@frozen
class PoseSearch:
    """A touch and an object, ready to compare."""

    scene: ContactScene
    points: CentredPoints
    object: PreparedObject
    outward: tuple[float, float, float] | None  # of the face toward the sensor; None = any
    max_distance_mm: float
    n_iterations: int
    keep_steps: bool
    # judges on the whole object: of where the best starts converge, and of the results
    rough: PoseJudge = field(init=False)
    fine: PoseJudge = field(init=False)

    def __post_init__(self) -> None:
        """Thin scene and object once for all comparisons."""
        model = self.object.model
        object.__setattr__(self, "rough", self._make_judge(model, _MIDDLE_CONTACT, _MIDDLE_MODEL))
        object.__setattr__(self, "fine", self._make_judge(model, _FINE_CONTACT, _FINE_MODEL))

    @property
    def middle_mm(self) -> Doubles:
        """Return the contact's centre (3,), where errors and motions are stated."""
        return self.points.centre_mm

    def find_promising(self, starts: Doubles, most: int = _N_POLISHED) -> list[Doubles]:
        """Return the distinct poses that starts (n, 4, 4) converge to, best first."""
        return self._distinct(self.register_roughly(starts), most)

    def select_likeliest(self, tried: Sequence[InitialPose]) -> Doubles:
        """Return the best poses of each orientation (n, 4, 4), best first."""
        n_model = int(np.clip(self.object.model.area_mm2 / _COARSE_MM2, *_COARSE_MODEL))
        by = self._make_judge(self.object.model, _COARSE_CONTACT, n_model)
        poses = np.array([s.sensor_from_object for s in tried])
        asked: dict[tuple[str, int], int] = {}
        chosen: list[int] = []
        for k in np.argsort(by.misfit_mm(poses), kind="stable"):
            asked[tried[k].group] = asked.get(tried[k].group, 0) + 1
            if asked[tried[k].group] <= _PER_GROUP:
                chosen.append(int(k))
        return poses[chosen[:_N_REGISTERED]]

    def track_previous_poses(self, starts: Sequence[Doubles]) -> list[PoseMinimum]:
        """Return the minima reached from the previous touch's poses, best first.

        None where not even the best fits.

        From the whole search distance or, where that fails, from nearby.
        """
        for tried in (list(self.register_roughly(np.array(starts))), starts):
            found = self.find_minima(tried)
            if found and self.explains(found[0]) and found[0].misfit_mm <= self.limit_mm:
                return found
        return []

    def register_roughly(self, poses: Doubles) -> Doubles:
        """Register poses (n, 4, 4) within the whole search distance, by a few of the points."""
        return register_from_starts(
            self.points.thin(_QUICK_POINTS), self.object.grid, poses, self._quick
        )

    @property
    def _quick(self) -> FitOptions:
        return FitOptions(
            max_distance_mm=self.max_distance_mm,
            n_iterations=_QUICK_ITERATIONS,
            convergence_mm=_QUICK_SETTLED_MM,
        )

    def prepend_history(self, starts: Doubles, steps: tuple[PoseStep, ...]) -> tuple[PoseStep, ...]:
        """Return the steps of a registration after those of the start (n, 4, 4) that led to it."""
        if not steps or not len(starts):
            return steps
        first = steps[0].sensor_from_object
        off_mm = [self.measure_distance_mm(first, end) for end in self.register_roughly(starts)]
        begun = starts[int(np.argmin(off_mm))]
        return (
            *trace_iterations(
                self.points.thin(_QUICK_POINTS), self.object.grid, begun, self._quick
            ),
            *steps,
        )

    def _distinct(self, poses: Doubles, most: int) -> list[Doubles]:
        misfits_mm = self.rough.misfit_mm(poses)
        kept: list[Doubles] = []
        for k in np.argsort(misfits_mm, kind="stable"):
            if all(
                rigid.poses_differ(poses[k], other, self.middle_mm, SAME_MM, SAME_DEG)
                for other in kept
            ):
                kept.append(poses[k])
            if len(kept) == most:
                break
        return kept

    def polish(
        self, pose: Doubles, *, dense: bool = False, known: Observability | None = None
    ) -> PoseMinimum | None:
        """Place by the outline where the surface is silent, then register on all points.

        None where that fails. `known` is what the scene determines at `pose`, if it is assessed.
        """
        known = known or self.assess_observability(pose)
        if len(known.weak_motions):
            pose = align_to_outline(
                pose, known.weak_motions, self.middle_mm, self.make_outline_judge(pose, dense=dense)
            )
        how = FitOptions(
            max_distance_mm=self.max_distance_mm / _POLISHED_SHARE,
            n_iterations=self.n_iterations,
            keep_steps=self.keep_steps,
            systematic_error=known.systematic_error,
            tolerances=known.tolerances,
        )
        fit = fit_pose(
            self.points if dense else self.points.thin(_POLISH_POINTS), self.object.grid, pose, how
        )
        if isinstance(fit, NotDetermined):
            return None
        return PoseMinimum(
            fit=fit, misfit_mm=float(self.fine.misfit_mm([fit.sensor_from_object])[0])
        )

    def measure_fit(self, pose: Doubles) -> tuple[float, float]:
        """Return the share of the contact on the object at `pose`, and its rms distance (mm)."""
        reach_mm = self.max_distance_mm / _POLISHED_SHARE
        fit = fit_pose(
            self.points,
            self.object.grid,
            pose,
            FitOptions(max_distance_mm=reach_mm, n_iterations=0),
        )
        return (0.0, math.nan) if isinstance(fit, NotDetermined) else (fit.fitness, fit.rmse_mm)

    def explains(self, minimum: PoseMinimum) -> bool:
        """Return whether the residual is within the depth's error and most of the contact is on
        the object.
        """
        return not self.describe_misfit(minimum.fit.fitness, minimum.fit.rmse_mm)

    def describe_misfit(self, fitness: float, rmse_mm: float) -> str:
        """Return in words how far a fit is from explaining the touch; "" where it does."""
        if fitness >= _MIN_FITNESS and rmse_mm <= self.limit_mm:
            return ""
        return (
            f"{fitness:.0%} of the contact lies on the object, {rmse_mm:.2g} mm off where the "
            "depth's error makes up "
            f"{self.limit_mm:.2g} mm"
        )

    @property
    def limit_mm(self) -> float:
        """Return the largest rms distance (mm) that the depth's error explains."""
        return _FAR * math.hypot(self.scene.noise_mm, self.scene.error.rms_mm, LEAST_SPREAD_MM)

    def find_equal_poses(
        self,
        first: Doubles,
        found: Sequence[Doubles],
        free: Doubles,
        progress: Progress,
        *,
        explained: bool,
    ) -> list[Doubles]:
        """Return poses that the touch cannot distinguish from `first`: of those found, rotated, and
        by compositions.

        Poses that differ only by the motions `free` (k, 6) are one. Where not even the first
        explains the touch, many fit equally badly: few are tried.
        """
        left = _MAX_ROTATED if explained else _MAX_ROTATED_DRAFT
        limit_mm = _NEAR * float(self.rough.misfit_mm([first])[0]) + LEAST_SPREAD_MM
        way = None if self.outward is None else np.array(self.outward)
        turns = [turn for turn in _TURNED_OVER if way is None or way @ turn @ way > 0]
        equal = list[Doubles]()
        tried = [*found, *(first @ self._about_middle(turn) for turn in turns)]
        for _round in range(_MAX_ITERATIONS):
            n_before = len(equal)
            for turned in (
                tried[k] for k in np.flatnonzero(self.rough.misfit_mm(tried) <= limit_mm)
            ):
                progress.step(1.0, "comparing poses that fit as well")
                pose = turned
                if len(equal) == _MAX_EQUAL or left == 0:
                    break
                new = all(self.poses_differ_beyond(pose, other, free) for other in (first, *equal))
                if new and self.fine.distinguishes(first, pose):
                    left -= 1
                    # after the rotation, a better fit may be nearby
                    better = self.polish(pose, dense=True)
                    pose = pose if better is None else better.fit.sensor_from_object
                    new = all(
                        self.poses_differ_beyond(pose, other, free) for other in (first, *equal)
                    )
                if new and not self.fine.distinguishes(first, pose):
                    equal.append(pose)
            if len(equal) == n_before:
                break
            # The motion from the first pose to an equal one takes this one to another.
            joined = [rigid.invert(first) @ pose for pose in equal]
            tried = [first @ a @ b for a in joined for b in joined]
        return equal

    def measure_distance_mm(self, a: Doubles, b: Doubles) -> float:
        """Return the distance (mm) of two poses at the contact: rotation about its centre, and
        translation.
        """
        relative = b @ rigid.invert(a)
        shift_mm = np.linalg.norm(rigid.apply(relative, self.middle_mm) - self.middle_mm)
        return math.radians(rigid.rotation_angle_deg(relative)) * self.points.radius_mm + float(
            shift_mm
        )

    def poses_differ_beyond(self, a: Doubles, b: Doubles, free: Doubles) -> bool:
        """Return whether two poses differ by more than the motions `free` (k, 6) at the centre."""
        turning_mm, sliding_mm = (np.linalg.norm(free[:, k : k + 3], axis=1) for k in (0, 3))
        straight = turning_mm * self.points.radius_mm <= SLIDE_ROTATION_LIMIT * sliding_mm
        turns = free[~straight]
        slides = np.linalg.qr(free[straight, 3:].T)[0]
        if len(turns):
            turn = rigid.rotation_vector_rad(b @ rigid.invert(a))
            a = rigid.apply_screw(
                a, np.linalg.lstsq(turns[:, :3].T, turn, rcond=None)[0] @ turns, self.middle_mm
            )
        left = rigid.apply(b @ rigid.invert(a), self.middle_mm) - self.middle_mm
        a = rigid.translation(*(slides @ (slides.T @ left))) @ a
        return rigid.poses_differ(a, b, self.middle_mm, SAME_MM, SAME_DEG)

    def _about_middle(self, turn: Doubles) -> Doubles:
        """Return a rotation (3, 3) of the object about its bounding box's centre as (4, 4)."""
        out = np.eye(4)
        out[:3, :3] = turn
        out[:3, 3] = self.object.middle_mm - turn @ self.object.middle_mm
        return out

    def _make_judge(self, model: ObjectModel, n_contact: int, n_model: int) -> PoseJudge:
        return make_judge(
            self.scene, self.object.grid, model, n_contact, n_model, self.max_distance_mm
        )

    def _tolerances(self, pose: Doubles, slopes: Doubles) -> Tolerances:
        """Return the tolerances with the error of normals here: of facets around the contact, and
        edges.

        Between nodes on both sides of an edge a gradient is the mean of two normals, and shorter.
        """
        model = self.object.model
        near = find_in_reach(self.scene, model, pose, _FACETS_REACH_MM)
        short_sq = 1.0 - slopes**2
        lattice_sq = float(np.where(short_sq > _BENT_SQ, short_sq, 0.0).mean()) / 2.0
        deg = _CORRELATED * math.degrees(
            math.sqrt(float(model.facet_error_sq[near].mean()) + lattice_sq)
        )
        return Tolerances(normal_error_deg=float(np.clip(deg, _STRAIGHT_DEG, NORMAL_ERROR_DEG)))

    def find_minima(
        self, starts: Sequence[Doubles], progress: Progress = SILENT
    ) -> list[PoseMinimum]:
        """Return the minima of the starts, best first.

        The best are placed and registered to convergence.
        """
        found: list[PoseMinimum] = []
        for k, start in enumerate(starts):
            progress.step(k / len(starts), f"refining {k + 1} of {len(starts)}")
            minimum = self.polish(start)
            found += [] if minimum is None else [minimum]
        found.sort(key=lambda m: m.misfit_mm)
        for k in range(min(_N_DENSE, len(found))):
            again = self.polish(found[k].fit.sensor_from_object, dense=True)
            while again is not None:
                gains = again.misfit_mm < _GAIN * found[k].misfit_mm
                found[k] = replace(
                    again, fit=replace(again.fit, steps=(*found[k].fit.steps, *again.fit.steps))
                )
                again = self.polish(again.fit.sensor_from_object, dense=True) if gains else None
        return sorted(found, key=lambda m: m.misfit_mm)

    def make_outline_judge(self, pose: Doubles, *, dense: bool = False) -> PoseJudge:
        """Return a judge on the part of the object around the contact, with dense points."""
        model = self.object.model
        part = model.select(find_in_reach(self.scene, model, pose, _OUTLINE_REACH_MM))
        if dense:
            return self._make_judge(part, _DENSE_CONTACT, _DENSE_MODEL)
        return self._make_judge(part, _OUTLINE_CONTACT, _OUTLINE_MODEL)

    def match(self, pose: Doubles) -> MatchedPoints:
        """Match the scene to the object at `pose`."""
        return match_points(self.scene, self.object.grid, pose)

    def assess_observability(self, pose: Doubles) -> Observability:
        """Assess which motions the scene determines at `pose`."""
        match = self.match(pose)
        return match.assess_observability(self.middle_mm, self._tolerances(pose, match.slopes))


OUTLINE_ONLY = "determined only by the outline of the contact"
# share of a rotation's displacement of the centroid; a shorter translation is not described
_MIN_SHIFT_SHARE = 0.1
_OPEN = "looking for what the touch leaves open"
# share of the contact on the object below which expect a wrong pose; check mesh and calibration
_MIN_ON_OBJECT = 0.5
# Of 90 simulated touches, measured or translated, six have their contact on the object and differ
# outside it by more than the depth's error: three wrong poses, and three right ones whose contacts
# lack a light part.
MISSING_CONTACT_WARNING = StageWarning(
    "at this pose the object would also touch outside the contact: expect a wrong pose, or a lost "
    "light contact"
)


@frozen
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
    chosen = _centre_on_contact(search, found[0], unseen)
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


def _describe_placement(words: str) -> str:
    """Return how a motion that nothing determines was set."""
    done = "where the contact's middle is" if words.startswith("moves") else "as first guessed"
    return f"not observable, kept {done}"


def _shown_by_outline(search: PoseSearch, pose: Doubles, known: Observability) -> list[bool]:
    """Return which of the weak motions the contact's outline determines."""
    if not known.weak_directions:
        return []
    by = search.make_outline_judge(pose)
    return [outline_constrains(pose, motion, search.middle_mm, by) for motion in known.weak_motions]


def _centre_on_contact(search: PoseSearch, minimum: PoseMinimum, unseen: Doubles) -> PoseMinimum:
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
        if not search.fine.distinguishes(pose, slid):
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
    if fit.fitness < _MIN_ON_OBJECT:
        long_mm, contact_mm = (
            float(np.ptp(p, axis=0).max())
            for p in (search.object.model.points_mm, search.scene.points_mm)
        )
        text = (
            f"the object, {long_mm:.2g} mm long, is smaller than its contact "
            f"({contact_mm:.2g} mm); check the unit"
            if long_mm < contact_mm
            else f"only {fit.fitness:.0%} of the contact lies on the object: expect a wrong pose; "
            "check the mesh"
        )
        return (StageWarning(text),)
    if search.explains(chosen):
        return () if chosen.misfit_mm <= search.limit_mm else (MISSING_CONTACT_WARNING,)
    text = search.describe_misfit(fit.fitness, fit.rmse_mm)
    return (StageWarning(f"{text}; expect a wrong pose, or check the mesh"),)
