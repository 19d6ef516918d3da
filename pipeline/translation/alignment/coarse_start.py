"""Initial alignments by grid search in the plane: outlines have many local minima."""

import itertools
from collections.abc import Iterator, Sequence

import numpy as np

from pipeline.core.arrays import Doubles, freeze
from pipeline.core.geometry import rigid
from pipeline.core.progress import Progress
from pipeline.sensors.alignment import Alignment, compose_motion
from pipeline.translation.alignment.normal_equations import (
    ResidualNoise,
    compute_cost,
    compute_touch_distances,
)
from pipeline.translation.alignment.residuals import Evidence, collect_evidence, thin_points
from pipeline.translation.alignment.touches import AlignmentTouch

# fixed, so that costs of different alignments compare
COMPARISON_NOISE = ResidualNoise(surface_mm=0.2, outline_mm=0.4)
COMPARISON_SCALE = ResidualNoise(surface_mm=1.0, outline_mm=2.0)
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
    for n, (right, down, turn) in enumerate(_grid()):
        if n % 50 == 0:
            progress.step(0.0, "searching for an initial alignment")
        motion = compose_motion(pivot_mm, np.deg2rad(turn) * normal, right * x + down * y)
        motion = rigid.translation(*(_lift_mm(few, motion @ start) * normal)) @ motion
        ranked.append(
            (
                compute_cost(few, motion @ start, COMPARISON_NOISE, COMPARISON_SCALE),
                n,
                right,
                down,
                motion,
            )
        )
    chosen: list[tuple[float, float]] = []
    found = [np.eye(4)]
    for _, _, right, down, motion in sorted(ranked, key=lambda entry: entry[:2]):
        if all(np.hypot(right - a, down - b) >= _APART_MM for a, b in chosen):
            chosen.append((right, down))
            found.append(motion)
        if len(found) > many:
            break
    return found


def _grid() -> Iterator[tuple[float, float, float]]:
    for turn in _TURNS_DEG:
        for right in _SHIFTS_MM:
            for down in _SHIFTS_MM:
                yield float(right), float(down), float(turn)


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
            best = min(
                best,
                (compute_cost(few, moved, COMPARISON_NOISE, COMPARISON_SCALE), moved),
                key=lambda one: one[0],
            )
    onward = best[1] @ rigid.invert(described.alignment_from_source)
    return Alignment(
        alignment_from_source=described.alignment_from_source, target_from_alignment=freeze(onward)
    )
