"""The way to a pose, step by step: where the object was, which point went with which place on it, and why it ended."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from pipeline.base.arrays import Doubles, Floats, Mask
from pipeline.geometry import rigid
from pipeline.geometry.distance_grid import DistanceGrid
from pipeline.stages.stage import StepCurve, StepHistory
from pipeline.values.results import ObjectPose, PoseStep


@dataclass(frozen=True, slots=True, kw_only=True)
class Correspondences:
    """What the registered points (n, 3) are held against at one step."""

    nearest_mm: Doubles  # (n, 3) the nearest place on the object, in the sensor's frame; NaN where none is near enough
    distance_mm: Doubles  # (n,) signed, + outside the object
    is_inlier: Mask  # (n,) near enough to count


def compute_correspondences(pose: ObjectPose, grid: DistanceGrid) -> Correspondences:
    """Those of a pose's registered points on the object, `grid` its signed distances."""
    assert pose.sensor_from_object is not None
    in_object = rigid.apply(rigid.invert(pose.sensor_from_object), pose.scene_mm)
    distance_mm, gradients = grid.at(in_object)
    size = np.linalg.norm(gradients, axis=1, keepdims=True)
    foot = in_object - distance_mm[:, None] * gradients / np.maximum(size, 1e-12)
    taken = np.abs(distance_mm) <= (pose.steps[0].max_correspondence_mm if pose.steps else np.inf)
    return Correspondences(
        nearest_mm=rigid.apply(pose.sensor_from_object, foot), distance_mm=distance_mm, is_inlier=taken
    )


def split_steps(pose: ObjectPose) -> tuple[ObjectPose, ...]:
    """The pose at each kept step, with that step alone."""
    return tuple(
        replace(
            pose, sensor_from_object=step.sensor_from_object, rmse_mm=step.rmse_mm, fitness=step.fitness, steps=(step,)
        )
        for step in pose.steps
    )  # fmt: skip


def summarise_steps(pose: ObjectPose) -> StepHistory | None:
    """How far off the points were and how many had a partner, how far each step moved them, and why it ended."""
    if not pose.steps:
        return None
    steps = pose.steps
    moved_mm = (0.0, *(_moved_mm(a, b, pose.scene_mm) for a, b in pairwise(steps)))
    start = f"from one of {pose.starts_tried} first guesses" if pose.starts_tried else "from the touch before"
    words = tuple(
        f"rms {s.rmse_mm:.3g} mm, {100 * s.fitness:.0f} % of the points with a partner"
        f"{'' if s.max_correspondence_mm == np.inf else f' within {s.max_correspondence_mm:g} mm'}, moved {moved:.2g} mm"
        for s, moved in zip(steps, moved_mm, strict=True)
    )
    return StepHistory(
        curves=(
            StepCurve(name="rms", unit="mm", values=tuple(s.rmse_mm for s in steps)),
            StepCurve(name="with a partner", unit="%", values=tuple(100 * s.fitness for s in steps)),
            StepCurve(name="moved", unit="mm", values=moved_mm),
        ),
        stop_reason=f"{start} in {len(steps) - 1} steps; {pose.stop_reason}", descriptions=words,
        phase_starts=tuple(k for k in range(1, len(steps)) if steps[k].max_correspondence_mm != steps[k - 1].max_correspondence_mm),
    )  # fmt: skip


def _moved_mm(a: PoseStep, b: PoseStep, points_mm: Floats) -> float:
    """How far (rms) the object moved at the registered points."""
    motion = b.sensor_from_object @ rigid.invert(a.sensor_from_object)
    off = rigid.apply(motion, points_mm) - points_mm
    return float(np.sqrt((off**2).sum(axis=1).mean())) if len(off) else 0.0
