"""The places where an object explains a touch: many first guesses compared, the best registered, the distinct kept.

Guesses are ranked by what was felt and by what was not; each step is more exact, and asks fewer of them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import permutations, product

import numpy as np

from pipeline.base.arrays import Doubles
from pipeline.base.progress import SILENT, Progress
from pipeline.geometry import rigid
from pipeline.geometry.screws import SLIDE_ROTATION_LIMIT
from pipeline.registration.gauss_newton import (
    CentredPoints,
    FitOptions,
    NotDetermined,
    PoseFit,
    fit_pose,
    register_from_starts,
    trace_iterations,
)
from pipeline.registration.object_preparation import PreparedObject
from pipeline.registration.observability import NORMAL_ERROR_DEG, Observability, Tolerances
from pipeline.registration.outline import align_to_outline, apply_screw
from pipeline.registration.point_matching import MatchedPoints, match_points
from pipeline.registration.ranking import LEAST_SPREAD_MM, PoseJudge, make_judge, poses_differ
from pipeline.registration.scene import ContactScene, select_in_reach
from pipeline.registration.starts import InitialPose
from pipeline.values.results import PoseStep

# Half or double of any count below finds no more poses, nor as many in clearly less time: benchmarks/search_counts.py.
_COARSE_FELT, _COARSE_MODEL = 50, (500, 4000)  # points that rank the first guesses: at least, at most
_COARSE_MM2 = 1.0  # of the object's surface for each of them
_MIDDLE_FELT, _MIDDLE_MODEL = 150, 1500  # points that rank where these lead
_FINE_FELT, _FINE_MODEL = 750, 15_000  # points that rank what came out of them
_OUTLINE_FELT, _OUTLINE_MODEL = 200, 1000  # points that place it where its surface is silent,
_POLISH_POINTS = 500  # that it is registered with, all of them once more
_DENSE_FELT, _DENSE_MODEL = 400, 4000  # and once more the best
_PER_GROUP, _N_REGISTERED, _N_POLISHED, _N_DENSE = 2, 96, 6, 2
_QUICK_POINTS, _QUICK_ITERATIONS, _QUICK_SETTLED_MM = 100, 10, 0.02
_GAIN = 0.95  # of the misfit: while a registration gains more, it is not at its end
_POLISHED_SHARE = 4.0  # the last registration searches this many times nearer
_OUTLINE_REACH_MM = 4.0  # object this far beyond the contact may stick out beside it
_MOST = 0.8  # share of the contact that lies on an object which explains it
_FAR = 3.0  # standard deviations
_NEAR = 2.0  # times the best one's misfit that few points may show of an equal one
_ROUNDS, _MOST_EQUAL = 3, 23  # of joining equals; all turns of a cube but one
_MOST_TURNED, _FEW_TURNED = 72, 12  # polished to find equals: what a cube asks for; where nothing explains the touch
_FACETS_REACH_MM = 0.5  # around the contact
_BENT_SQ = 0.005  # sine squared of half an edge's angle; on round surfaces the lattice errs by less
_TOGETHER = 1.5  # errors of facets hang together over a contact: their mean may exceed their rms by this
_STRAIGHT_DEG = 0.5  # of a lattice's gradients on a flat face (tests/pipeline/geometry/test_distance_grid.py: 0.3)
SAME_MM, SAME_DEG = 1.0, 5.0  # poses this close are one


_TURNED_OVER = tuple(
    turn for axes in permutations(range(3)) for signs in product((1.0, -1.0), repeat=3)
    if np.linalg.det(turn := np.eye(3)[list(axes)] * signs) > 0 and not np.array_equal(turn, np.eye(3))
)  # fmt: skip
"""The 23 turns that take the axes of an object to themselves."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseMinimum:
    """A place where a registration ended."""

    fit: PoseFit
    misfit_mm: float


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseSearch:
    """A touch and an object, ready to be compared."""

    scene: ContactScene
    points: CentredPoints
    object: PreparedObject
    outward: tuple[float, float, float] | None  # of the face that is toward the sensor; None = any
    max_distance_mm: float
    n_iterations: int
    keep_steps: bool

    @property
    def middle_mm(self) -> Doubles:
        """Of the contact, which errors and motions are told at."""
        return self.points.centre_mm

    def find_promising(self, starts: Doubles) -> list[Doubles]:
        """Where starts (n, 4, 4) lead, best first, the distinct ones."""
        return self._distinct(self.register_roughly(starts))

    def select_likeliest(self, tried: Sequence[InitialPose]) -> Doubles:
        """The best places of each orientation (n, 4, 4), best first."""
        n_model = int(np.clip(self.object.model.area_mm2 / _COARSE_MM2, *_COARSE_MODEL))
        by = make_judge(self.scene, self.object.grid, self.object.model, _COARSE_FELT, n_model, self.max_distance_mm)
        poses = np.array([s.sensor_from_object for s in tried])
        asked: dict[tuple[str, int], int] = {}
        chosen: list[int] = []
        for k in np.argsort(by.misfit_mm(poses), kind="stable"):
            asked[tried[k].group] = asked.get(tried[k].group, 0) + 1
            if asked[tried[k].group] <= _PER_GROUP:
                chosen.append(int(k))
        return poses[chosen[:_N_REGISTERED]]

    def track_previous_poses(self, starts: Sequence[Doubles]) -> list[PoseMinimum]:
        """The minima that poses of the touch before lead to, best first; none where not even the best one fits.

        From within the whole search distance or, where that leads astray, from near by.
        """
        for tried in (list(self.register_roughly(np.array(starts))), starts):
            found = self.find_minima(tried)
            if found and self.explains(found[0]) and found[0].misfit_mm <= self.limit_mm:
                return found
        return []

    def register_roughly(self, poses: Doubles) -> Doubles:
        """Where poses (n, 4, 4) lead within the whole search distance, by a few of the points."""
        return register_from_starts(self.points.thin(_QUICK_POINTS), self.object.grid, poses, self._quick)

    @property
    def _quick(self) -> FitOptions:
        return FitOptions(
            max_distance_mm=self.max_distance_mm, n_iterations=_QUICK_ITERATIONS, convergence_mm=_QUICK_SETTLED_MM
        )

    def prepend_history(self, starts: Doubles, steps: tuple[PoseStep, ...]) -> tuple[PoseStep, ...]:
        """The steps of a registration after those of whichever start (n, 4, 4) led to where it begins."""
        if not steps or not len(starts):
            return steps
        first = steps[0].sensor_from_object
        off_mm = [self.measure_distance_mm(first, end) for end in self.register_roughly(starts)]
        begun = starts[int(np.argmin(off_mm))]
        return (*trace_iterations(self.points.thin(_QUICK_POINTS), self.object.grid, begun, self._quick), *steps)

    def _distinct(self, poses: Doubles) -> list[Doubles]:
        misfits_mm = self._middle().misfit_mm(poses)
        kept: list[Doubles] = []
        for k in np.argsort(misfits_mm, kind="stable"):
            if all(poses_differ(poses[k], other, self.middle_mm, SAME_MM, SAME_DEG) for other in kept):
                kept.append(poses[k])
            if len(kept) == _N_POLISHED:
                break
        return kept

    def polish(self, pose: Doubles, *, dense: bool = False) -> PoseMinimum | None:
        """Set by the outline where the surface is silent, then registered on all points; None where that fails."""
        known = self.assess_observability(pose)
        if len(known.weak_motions):
            pose = align_to_outline(
                pose, known.weak_motions, self.middle_mm, self.make_outline_judge(pose, dense=dense)
            )
        how = FitOptions(
            max_distance_mm=self.max_distance_mm / _POLISHED_SHARE, n_iterations=self.n_iterations,
            keep_steps=self.keep_steps, systematic_error=known.systematic_error, tolerances=known.tolerances,
        )  # fmt: skip
        fit = fit_pose(self.points if dense else self.points.thin(_POLISH_POINTS), self.object.grid, pose, how)
        if isinstance(fit, NotDetermined):
            return None
        return PoseMinimum(fit=fit, misfit_mm=float(self.make_fine_judge().misfit_mm([fit.sensor_from_object])[0]))

    def explains(self, minimum: PoseMinimum) -> bool:
        """Whether what is left of a fit is no more than the depth's own error, and most of the contact is on it."""
        return minimum.fit.fitness >= _MOST and minimum.fit.rmse_mm <= self.limit_mm

    @property
    def limit_mm(self) -> float:
        """Largest rms distance that the error of the depth makes up."""
        return _FAR * math.hypot(self.scene.noise_mm, self.scene.error.rms_mm, LEAST_SPREAD_MM)

    def find_equal_poses(
        self, first: Doubles, found: Sequence[Doubles], free: Doubles, progress: Progress, *, explained: bool
    ) -> list[Doubles]:
        """Poses that the touch does not tell from the `first`: of those found, turned over, and by what joins them.

        Poses that only the motions `free` (k, 6) lie between count as one. Where not even the first has `explained` the
        touch, any number fit as badly: a few of them are looked for.
        """
        left = _MOST_TURNED if explained else _FEW_TURNED
        fine, rough = self.make_fine_judge(), self._middle()
        limit_mm = _NEAR * float(rough.misfit_mm([first])[0]) + LEAST_SPREAD_MM
        way = None if self.outward is None else np.array(self.outward)
        turns = [turn for turn in _TURNED_OVER if way is None or way @ turn @ way > 0]
        equal, tried = list[Doubles](), [*found, *(first @ self._about_middle(turn) for turn in turns)]
        for _round in range(_ROUNDS):
            n_before = len(equal)
            for turned in (tried[k] for k in np.flatnonzero(rough.misfit_mm(tried) <= limit_mm)):
                progress.step(1.0, "comparing poses that fit as well")
                pose = turned
                if len(equal) == _MOST_EQUAL or left == 0:
                    break
                new = all(self.poses_differ_beyond(pose, other, free) for other in (first, *equal))
                if new and fine.distinguishes(first, pose):
                    left -= 1
                    better = self.polish(pose, dense=True)  # turned over, it may lie better a little farther on
                    pose = pose if better is None else better.fit.sensor_from_object
                    new = all(self.poses_differ_beyond(pose, other, free) for other in (first, *equal))
                if new and not fine.distinguishes(first, pose):
                    equal.append(pose)
            if len(equal) == n_before:
                break
            # What takes the first to one of its equals takes this one to another.
            joined = [rigid.invert(first) @ pose for pose in equal]
            tried = [first @ a @ b for a in joined for b in joined]
        return equal

    def measure_distance_mm(self, a: Doubles, b: Doubles) -> float:
        """How far two poses are from each other at the contact: turned about its middle, and shifted there."""
        relative = b @ rigid.invert(a)
        shift_mm = np.linalg.norm(rigid.apply(relative, self.middle_mm) - self.middle_mm)
        return math.radians(rigid.rotation_angle_deg(relative)) * self.points.radius_mm + float(shift_mm)

    def poses_differ_beyond(self, a: Doubles, b: Doubles, free: Doubles) -> bool:
        """Whether two poses differ by more than the motions (k, 6) of (rotation rad, translation mm) at the middle."""
        turning_mm, sliding_mm = (np.linalg.norm(free[:, k : k + 3], axis=1) for k in (0, 3))
        straight = turning_mm * self.points.radius_mm <= SLIDE_ROTATION_LIMIT * sliding_mm
        turns, slides = free[~straight], np.linalg.qr(free[straight, 3:].T)[0]
        if len(turns):
            turn = rigid.rotation_vector_rad(b @ rigid.invert(a))
            a = apply_screw(a, np.linalg.lstsq(turns[:, :3].T, turn, rcond=None)[0] @ turns, self.middle_mm)
        left = rigid.apply(b @ rigid.invert(a), self.middle_mm) - self.middle_mm
        a = rigid.translation(*(slides @ (slides.T @ left))) @ a
        return poses_differ(a, b, self.middle_mm, SAME_MM, SAME_DEG)

    def _about_middle(self, turn: Doubles) -> Doubles:
        """A rotation (3, 3) of the object about the middle of its box, (4, 4)."""
        out = np.eye(4)
        out[:3, :3], out[:3, 3] = turn, self.object.middle_mm - turn @ self.object.middle_mm
        return out

    def _middle(self) -> PoseJudge:
        model = self.object.model
        return make_judge(self.scene, self.object.grid, model, _MIDDLE_FELT, _MIDDLE_MODEL, self.max_distance_mm)

    def _tolerances(self, pose: Doubles, slopes: Doubles) -> Tolerances:
        """Those of the observability, with the error that normals have here: of facets around the contact, and edges.

        Between the nodes on both sides of an edge a gradient is the mean of two normals, and shorter for it.
        """
        near = select_in_reach(self.scene, self.object.model, pose, _FACETS_REACH_MM)
        short_sq = 1.0 - slopes**2
        lattice_sq = float(np.where(short_sq > _BENT_SQ, short_sq, 0.0).mean()) / 2.0
        deg = _TOGETHER * math.degrees(math.sqrt(float(near.facet_error_sq.mean()) + lattice_sq))
        return Tolerances(normal_error_deg=float(np.clip(deg, _STRAIGHT_DEG, NORMAL_ERROR_DEG)))

    def make_fine_judge(self) -> PoseJudge:
        """A judge on the whole object."""
        return make_judge(
            self.scene, self.object.grid, self.object.model, _FINE_FELT, _FINE_MODEL, self.max_distance_mm
        )

    def find_minima(self, starts: Sequence[Doubles], progress: Progress = SILENT) -> list[PoseMinimum]:
        """The minima that the starts lead to, best first; the best are set by the outline more exactly, to the end."""
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
                found[k] = replace(again, fit=replace(again.fit, steps=(*found[k].fit.steps, *again.fit.steps)))
                again = self.polish(again.fit.sensor_from_object, dense=True) if gains else None
        return sorted(found, key=lambda m: m.misfit_mm)

    def make_outline_judge(self, pose: Doubles, *, dense: bool = False) -> PoseJudge:
        """A judge on the part of the object around the contact, so that its points lie dense there."""
        part = select_in_reach(self.scene, self.object.model, pose, _OUTLINE_REACH_MM)
        n_felt, n_model = (_DENSE_FELT, _DENSE_MODEL) if dense else (_OUTLINE_FELT, _OUTLINE_MODEL)
        return make_judge(self.scene, self.object.grid, part, n_felt, n_model, self.max_distance_mm)

    def match(self, pose: Doubles) -> MatchedPoints:
        """What of the scene shows the object that is placed so."""
        return match_points(self.scene, self.object.grid, pose)

    def assess_observability(self, pose: Doubles) -> Observability:
        """Which motions the scene determines where the object is placed so."""
        match = self.match(pose)
        return match.assess_observability(self.middle_mm, self._tolerances(pose, match.slopes))
