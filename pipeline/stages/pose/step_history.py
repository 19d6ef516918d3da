"""The iterations of a registration: object poses, point correspondences, and why it stopped."""

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
    """Nearest points on the object of the registered points (n, 3) at one step."""

    nearest_mm: Doubles  # (n, 3) nearest points on the object, in the sensor's frame
    distance_mm: Doubles  # (n,) signed, + outside the object
    is_inlier: Mask  # (n,) within the search distance


def compute_correspondences(pose: ObjectPose, grid: DistanceGrid) -> Correspondences:
    """Nearest points on the object of a pose's registered points; `grid` holds the object's signed distances."""
    assert pose.sensor_from_object is not None
    in_object = rigid.apply(rigid.invert(pose.sensor_from_object), pose.scene_mm)
    distance_mm, gradients = grid.at(in_object)
    size = np.linalg.norm(gradients, axis=1, keepdims=True)
    foot = in_object - distance_mm[:, None] * gradients / np.maximum(size, 1e-12)
    inliers = np.abs(distance_mm) <= (pose.steps[0].max_correspondence_mm if pose.steps else np.inf)
    return Correspondences(
        nearest_mm=rigid.apply(pose.sensor_from_object, foot), distance_mm=distance_mm, is_inlier=inliers
    )


def split_steps(pose: ObjectPose) -> tuple[ObjectPose, ...]:
    """The pose at each kept step, with that step only."""
    return tuple(
        replace(
            pose, sensor_from_object=step.sensor_from_object, rmse_mm=step.rmse_mm, fitness=step.fitness, steps=(step,)
        )
        for step in pose.steps
    )  # fmt: skip


def summarise_steps(pose: ObjectPose) -> StepHistory | None:
    """Curves of rms, inlier share and motion per step, and why the registration stopped."""
    if not pose.steps:
        return None
    steps = pose.steps
    motion_mm = (0.0, *(_measure_motion_mm(a, b, pose.scene_mm) for a, b in pairwise(steps)))
    start = f"from one of {pose.starts_tried} starts" if pose.starts_tried else "from the pose of the previous touch"
    words = tuple(
        f"rms {s.rmse_mm:.3g} mm, {100 * s.fitness:.0f} % of the points with a correspondence"
        f"{'' if s.max_correspondence_mm == np.inf else f' within {s.max_correspondence_mm:g} mm'}, "
        f"moved by {motion:.2g} mm"
        for s, motion in zip(steps, motion_mm, strict=True)
    )
    return StepHistory(
        curves=(
            StepCurve(name="rms", unit="mm", values=tuple(s.rmse_mm for s in steps)),
            StepCurve(name="with a correspondence", unit="%", values=tuple(100 * s.fitness for s in steps)),
            StepCurve(name="motion", unit="mm", values=motion_mm),
        ),
        stop_reason=f"{start} in {len(steps) - 1} steps; {pose.stop_reason}", descriptions=words,
        phase_starts=tuple(k for k in range(1,
        len(steps)) if steps[k].max_correspondence_mm != steps[k - 1].max_correspondence_mm),
    )  # fmt: skip


def _measure_motion_mm(a: PoseStep, b: PoseStep, points_mm: Floats) -> float:
    """Rms displacement of the registered points between two steps."""
    motion = b.sensor_from_object @ rigid.invert(a.sensor_from_object)
    displacement = rigid.apply(motion, points_mm) - points_mm
    return float(np.sqrt((displacement**2).sum(axis=1).mean())) if len(displacement) else 0.0
