"""Refine an alignment to many touches at once.

Report undetermined directions and the fit on held-out touches.

Initial alignments by grid search in the plane: outlines have many local minima.
"""

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from pipeline.core.arrays import Doubles, freeze
from pipeline.core.errors import SettingProblem
from pipeline.core.frozen import frozen
from pipeline.core.geometry import rigid
from pipeline.core.geometry.screws import describe_motions
from pipeline.core.progress import SILENT, Progress
from pipeline.sensors.alignment import Alignment, compose_motion, correct_alignment
from pipeline.stages.depth.photometric import DepthParams
from pipeline.translation.alignment.residuals import (
    TOLERANCE_DEG,
    TOLERANCE_MM,
    TOLERANCE_UNITS,
    Evidence,
    NormalEquations,
    accumulate_sums,
    collect_evidence,
    compute_cost,
    compute_touch_distances,
    estimate_growth_mm,
    estimate_noise,
    thin_points,
)
from pipeline.translation.alignment.touches import AlignmentTouch, load_paired_touches
from pipeline.translation.translate import Translation

_SHIFTS_MM = np.arange(-4.0, 4.5, 1.0)
_TURNS_DEG = np.arange(-8.0, 8.5, 4.0)
_ALL_TURNS_RAD = np.deg2rad(np.arange(0.0, 360.0, 15.0))  # without an initial alignment
_WIDE_SHIFTS_MM = np.arange(-8.0, 8.5, 2.0)
_TOUCHES = 4  # touches compared, spread over all
_POINTS = 80  # points of each kind
_APART_MM = 1.5  # starts nearer than this, and within one rotation step, converge alike


def list_initial_alignments(
    touches: Sequence[Evidence], start: Doubles, pivot_mm: Doubles, many: int, progress: Progress
) -> list[Doubles]:
    """Return motions (4, 4) to apply after `start`: the identity first, then the `many` best
    distinct ones of a grid.

    The grid spans 4 mm and 8 deg in the plane normal to the source's optical axis; after each
    translation the surfaces are brought together along that axis, because a wrong translation
    mostly shifts depth.
    """
    few = [thin_points(t, _POINTS) for t in touches[:: max(1, -(-len(touches) // _TOUCHES))]]
    x, y, normal = start[:3, :3].T
    ranked: list[tuple[float, int, float, float, Doubles]] = []
    grid = itertools.product(_TURNS_DEG, _SHIFTS_MM, _SHIFTS_MM)
    for n, (turn, right, down) in enumerate(grid):
        if n % 50 == 0:
            progress.step(0.0, "searching for an initial alignment")
        motion = compose_motion(pivot_mm, np.deg2rad(turn) * normal, right * x + down * y)
        motion = rigid.translation(*(_lift_mm(few, motion @ start) * normal)) @ motion
        ranked.append((compute_cost(few, motion @ start), n, right, down, motion))
    chosen: list[tuple[float, float]] = []
    found = [np.eye(4)]
    for _, _, right, down, motion in sorted(ranked, key=lambda entry: entry[:2]):
        if all(np.hypot(right - a, down - b) >= _APART_MM for a, b in chosen):
            chosen.append((right, down))
            found.append(motion)
        if len(found) > many:
            break
    return found


def _lift_mm(touches: Sequence[Evidence], target_from_source: Doubles) -> float:
    """Return the translation (mm) along the source's axis that closes the gap between the
    surfaces.
    """
    normal = target_from_source[:3, 2]
    surfaces = [one.surface for one in compute_touch_distances(touches, target_from_source)]
    found = [s.mm / (s.jacobian @ normal) for s in surfaces if s.mm.size]
    return -float(np.median(np.concatenate(found))) if found else 0.0


def estimate_alignment(
    touches: Sequence[AlignmentTouch], described: Alignment, progress: Progress
) -> Alignment:
    """Return the alignment that a grid search finds without an initial one, stored on the target's
    side.

    The optical axes are taken as parallel. At each rotation about them the contacts are laid over
    each other, then translated by up to 8 mm; the cost is that of the refinement. Touches have
    contact on both sensors.
    """
    few = [thin_points(collect_evidence(t), _POINTS) for t in touches]
    sources = np.array([e.surface_mm.mean(axis=0) for e in few])
    targets = np.array(
        [
            np.nanmean(e.camera.back_project(e.depth_mm), axis=(0, 1)) + e.instance_shift_mm
            for e in few
        ]
    )
    best = (np.inf, np.eye(4))
    for k, turn in enumerate(_ALL_TURNS_RAD):
        progress.step(k / len(_ALL_TURNS_RAD), "searching for an initial orientation")
        around = rigid.rotation((0.0, 0.0, turn))
        shift = np.median(targets - rigid.apply(around, sources), axis=0)
        for right, down in itertools.product(_WIDE_SHIFTS_MM, _WIDE_SHIFTS_MM):
            moved = rigid.translation(shift[0] + right, shift[1] + down, shift[2]) @ around
            moved = rigid.translation(0.0, 0.0, _lift_mm(few, moved)) @ moved
            best = min(best, (compute_cost(few, moved), moved), key=lambda one: one[0])
    onward = best[1] @ rigid.invert(described.alignment_from_source)
    return replace(described, target_from_alignment=freeze(onward))


# first loss scales of surface and outline, mm: as far as a start may be off
_START = np.array([2.0, 4.0])
_START_NEAR = np.array([0.5, 1.0])  # from a start that is roughly right
_ROUGH_POINTS = 120  # of each kind and touch, for the rough part
# factor on the scale per iteration; wide first, so that a distant start is not rejected as outliers
_NARROWING = 0.75
_LOSS_SCALE = 3.0  # final loss scale in standard deviations
_ROUNDS = 60
_CONVERGENCE = 0.002  # of a tolerance, convergence: 0.4 um, 0.002 deg
_MAX_STEP = 10.0  # tolerances in one step: 2 mm, 10 deg
_TRIES = 8
_N_STARTS = 3  # starts besides the given alignment
_RADIUS_MM = TOLERANCE_MM / np.deg2rad(
    TOLERANCE_DEG
)  # scales a rotation of the tolerance to the length of a translation of the tolerance


@frozen
class AlignmentFit:
    """Disagreement of touches under an alignment, medians over all points."""

    surface_mm: float  # |distance| to the target's surface along its normal
    outline_mm: float  # |distance| to the target's outline, less each touch's growth
    share_compared: float  # share of the points that had something to compare with
    n_touches: int


@frozen
class Refinement:
    """A refined alignment and its uncertainty."""

    alignment: Alignment
    motion: Doubles  # (4, 4) mm, target frame: applied after the old T_S->T
    pivot_mm: Doubles  # (3,) target frame
    # (6,) predicted standard deviations (deg about the pivot, mm); 0 along frozen directions
    std: Doubles
    weak_directions: tuple[str, ...]  # undetermined directions in words; left unchanged
    used_fit: tuple[AlignmentFit, AlignmentFit]  # before, after
    held_out_fit: tuple[AlignmentFit, AlignmentFit] | None
    n_iterations: int
    converged: bool
    notes: tuple[str, ...] = ()


def refine_alignment(
    touches: Sequence[AlignmentTouch],
    alignment: Alignment,
    *,
    held_out: Sequence[AlignmentTouch] = (),
    tolerance: float = 1.0,
    progress: Progress = SILENT,
) -> Refinement:
    """Fit one rigid correction of T_S->T to all `touches` by least squares, stored in T_A->T.

    Damped Gauss-Newton with a Geman-McClure loss that narrows from millimetres to three standard
    deviations; see `residuals` for what is compared. Directions whose predicted std exceeds
    `tolerance` times 0.2 mm or 1 deg are frozen and named. `held_out` touches are only evaluated,
    before and after. Raises SettingProblem when no touch has contact on both sensors, or for a
    tolerance that is not positive.
    """
    if not 0.0 < tolerance < np.inf:
        raise SettingProblem(
            f"the tolerance of a refinement must be positive and finite, got {tolerance:g}"
        )
    kept = [collect_evidence(t) for t in touches if t.has_contact_on_both]
    kept = [e for e in kept if len(e.surface_mm) and len(e.outline_mm)]
    if not kept:
        raise SettingProblem("no frame has contact on both sensors; refinement needs some")
    others = [collect_evidence(t) for t in held_out if t.has_contact_on_both]
    start = alignment.target_from_source
    pivot = np.mean([rigid.apply(start, e.surface_mm).mean(axis=0) for e in kept], axis=0)
    solver = _Solver(kept, start, pivot, progress)
    rough = _Solver([thin_points(e, _ROUGH_POINTS) for e in kept], start, pivot, progress)
    motion = rough.solve_from_starts(
        list_initial_alignments(kept, start, pivot, _N_STARTS, progress)
    )
    motion, converged = solver.solve(motion, np.eye(6), _START_NEAR)
    information = solver.build_final_equations(motion).information
    free, lost = _split_determined(information, tolerance)
    if lost.shape[1]:
        motion, converged = solver.solve_within(motion, free)
    certain = free.T @ solver.build_final_equations(motion).information @ free
    spread = (
        np.sqrt(np.diag(free @ np.linalg.inv(certain) @ free.T)) if free.shape[1] else np.zeros(6)
    )
    after = motion @ start
    notes: tuple[str, ...] = ()
    if not converged:
        notes = (
            f"not converged after {solver.iterations} iterations; start from a closer alignment",
        )
    progress.step(1.0, "refined")
    return Refinement(
        alignment=correct_alignment(alignment, motion),
        motion=freeze(motion),
        pivot_mm=freeze(pivot),
        std=freeze(spread * np.array([TOLERANCE_DEG] * 3 + [TOLERANCE_MM] * 3)),
        weak_directions=tuple(
            words
            for words, _ in describe_motions(
                lost,
                pivot,
                float(_RADIUS_MM),
                lambda v: bool(tolerance**2 * (v @ information @ v) < v @ v),
            )
        ),
        used_fit=(measure_fit(kept, start), measure_fit(kept, after)),
        held_out_fit=(measure_fit(others, start), measure_fit(others, after)) if others else None,
        n_iterations=solver.iterations,
        converged=converged,
        notes=notes,
    )


def refine_on_recording(
    translation: Translation,
    frames: Iterable[int],
    *,
    start: Alignment | None = None,
    params: DepthParams | None = None,
    exact: bool = False,
    hold_out: float = 0.0,
    tolerance: float = 1.0,
    progress: Progress = SILENT,
) -> Refinement:
    """Refine on those frames of a recording that have contact on both sensors, but for a share
    `hold_out`.

    It starts from `start`, else the translation's alignment; depth is as in `load_paired_touch`.
    Raises SettingProblem without such frames.
    """
    touches = load_paired_touches(translation, frames, params, exact=exact, progress=progress)
    used, held_out = hold_out_touches(touches, hold_out)
    return refine_alignment(
        used,
        start or translation.alignment,
        held_out=held_out,
        tolerance=tolerance,
        progress=progress,
    )


def hold_out_touches(
    touches: Sequence[AlignmentTouch], share: float
) -> tuple[list[AlignmentTouch], list[AlignmentTouch]]:
    """(the touches to fit, those held out): evenly spread over the recording, one at least to
    fit.
    """
    n = min(round(share * len(touches)), len(touches) - 1)
    held_out = {int((k + 0.5) * len(touches) / n) for k in range(n)}
    parts: tuple[list[AlignmentTouch], list[AlignmentTouch]] = [], []
    for k, touch in enumerate(touches):
        parts[k in held_out].append(touch)
    return parts


def measure_fit(touches: Sequence[Evidence], target_from_source: Doubles) -> AlignmentFit:
    """Return the disagreement of `touches` under this T_S->T.

    NaN where no point had something to compare with.
    """
    distances = compute_touch_distances(touches, target_from_source)
    noise_mm = float(estimate_noise(distances)[1])
    surface = np.concatenate([s.surface.mm for s in distances])
    outline = np.concatenate(
        [
            s.outline.mm
            - estimate_growth_mm(
                s.outline.mm, noise_mm * _LOSS_SCALE, noise_mm, s.outline.n_points
            )[0]
            for s in distances
        ]
    )
    asked = sum(s.surface.n_points + s.outline.n_points for s in distances)
    return AlignmentFit(
        surface_mm=float(np.median(np.abs(surface))) if surface.size else float("nan"),
        outline_mm=float(np.median(np.abs(outline))) if outline.size else float("nan"),
        share_compared=(surface.size + outline.size) / asked if asked else 0.0,
        n_touches=len(touches),
    )


class _Solver:
    """Damped Gauss-Newton from one start."""

    def __init__(
        self, touches: Sequence[Evidence], start: Doubles, pivot_mm: Doubles, progress: Progress
    ) -> None:
        self._touches = touches
        self._start = start
        self._pivot = pivot_mm
        self._progress = progress
        self.iterations = 0

    def solve_from_starts(self, beginnings: Sequence[Doubles]) -> Doubles:
        """Return the solution of least cost over several starts."""
        found = [self.solve(b, np.eye(6))[0] for b in beginnings]
        costs = [compute_cost(self._touches, motion @ self._start) for motion in found]
        return found[int(np.argmin(costs))]

    def solve_within(self, solution: Doubles, free: Doubles) -> tuple[Doubles, bool]:
        """Return the solution within the span of `free` (6, k) steps from the start."""
        if not free.shape[1]:
            return np.eye(4), True
        step = self._as_step(solution)
        turn, shift = np.split(free @ (free.T @ step) * TOLERANCE_UNITS, 2)
        return self.solve(compose_motion(self._pivot, turn, shift), free, _START_NEAR)

    def solve(
        self, motion: Doubles, free: Doubles, scale: Doubles = _START
    ) -> tuple[Doubles, bool]:
        """Return the best motion (4, 4) from this one within the span of `free` (6, k), and
        whether it converged.
        """
        damping = 1e-3
        for done in range(_ROUNDS):
            self._progress.step(
                done / _ROUNDS, f"iteration {done + 1}: outlines to {scale[1]:.2f} mm"
            )
            self.iterations += 1
            distances = compute_touch_distances(self._touches, motion @ self._start)
            noise = estimate_noise(distances)
            wide = np.maximum(scale, _LOSS_SCALE * noise)
            here = accumulate_sums(distances, self._touches, self._pivot, noise, wide)
            motion, damping, length = self._step(motion, here, noise, wide, free, damping)
            if length < _CONVERGENCE and (wide > scale).all():
                return motion, True
            scale = scale * _NARROWING
        return motion, False

    def build_final_equations(self, motion: Doubles) -> NormalEquations:
        """Return the final quadratic model, with the remaining noise."""
        distances = compute_touch_distances(self._touches, motion @ self._start)
        noise = estimate_noise(distances)
        return accumulate_sums(distances, self._touches, self._pivot, noise, _LOSS_SCALE * noise)

    def _as_step(self, motion: Doubles) -> Doubles:
        """Return the step (6,) in tolerances that gives this motion; inverse of `motion_about`."""
        shift = rigid.apply(motion, self._pivot) - self._pivot
        return np.concatenate([rigid.rotation_vector_rad(motion), shift]) / TOLERANCE_UNITS

    def _step(
        self,
        motion: Doubles,
        here: NormalEquations,
        noise: Doubles,
        scale: Doubles,
        free: Doubles,
        damping: float,
    ) -> tuple[Doubles, float, float]:
        """Return the next motion, damping, and the step length in tolerances.

        Length 0 when no step improves.
        """
        information = free.T @ here.information @ free
        gradient = free.T @ here.gradient
        load = np.maximum(np.diag(information), 1e-6 * np.trace(information) + 1e-12)
        for _ in range(_TRIES):
            step = -free @ np.linalg.solve(information + damping * np.diag(load), gradient)
            length = float(np.linalg.norm(step))
            step *= min(1.0, _MAX_STEP / max(length, 1e-12))
            turn, shift = np.split(step * TOLERANCE_UNITS, 2)
            moved = compose_motion(self._pivot, turn, shift) @ motion
            there = accumulate_sums(
                compute_touch_distances(self._touches, moved @ self._start),
                self._touches,
                self._pivot,
                noise,
                scale,
            )
            if there.cost <= here.cost:
                return moved, max(damping / 3.0, 1e-6), length
            damping = damping * 5.0
        return motion, damping, 0.0


def _split_determined(information: Doubles, tolerance: float) -> tuple[Doubles, Doubles]:
    """Return orthonormal directions (6, k) known to within `tolerance` units, and the others."""
    certainty, directions = np.linalg.eigh(0.5 * (information + information.T))
    weak = ~(certainty * tolerance**2 > 1.0)
    return directions[:, ~weak], directions[:, weak]
