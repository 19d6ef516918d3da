"""Run a recorded rollout again from its plan: to attribute the error of its decisions, and to
replay it.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from pipeline.core.errors import NotConverged
from pipeline.core.progress import SILENT, Progress
from pipeline.lab.tasks.task import Decision, RecordedRollout, Rollout, load_task

# of poses and forces: rounding of another processor
SAME_MM = 1e-3
SAME_N = 1e-2
_LEAST_MM = 0.05  # a share that is named


@dataclass(frozen=True, slots=True, kw_only=True)
class RolloutAgreement:
    """How well a rollout that was run again agrees with its recording."""

    same_outcome: bool
    pose_mm: float  # largest difference of an object position; inf = another number of ticks
    force_n: float  # largest difference of a contact force

    @property
    def is_same(self) -> bool:
        """Whether all is the same but for rounding."""
        return self.same_outcome and self.pose_mm <= SAME_MM and self.force_n <= SAME_N


def run_again(
    rollout: RecordedRollout, progress: Progress = SILENT, *, attribute: bool = False
) -> Rollout:
    """The rollout of the same plan, with its errors attributed if asked; raises TouchError."""
    plan = replace(rollout.plan, attribute=attribute, record_frames=True)
    (again,) = load_task(plan.task).run(plan, progress)
    return again


def compare_rollouts(recorded: RecordedRollout, again: Rollout) -> RolloutAgreement:
    """Compare a rollout with its recording."""
    if len(again.ticks) != recorded.n_ticks:
        return RolloutAgreement(same_outcome=False, pose_mm=math.inf, force_n=math.inf)
    poses = np.array([tick.world_from_object[:3, 3] for tick in again.ticks])
    forces = np.array([tick.force_n for tick in again.ticks])
    return RolloutAgreement(
        same_outcome=again.succeeds == recorded.summary.succeeds,
        pose_mm=float(np.abs(poses - recorded.world_from_object[:, :3, 3]).max()),
        force_n=float(np.abs(forces - recorded.force_n).max()),
    )


def attribute_rollout(
    rollout: RecordedRollout, progress: Progress = SILENT
) -> tuple[Decision, ...]:
    """The decisions with their errors attributed: as recorded, or by running the rollout again.

    Raises NotConverged where the rollout that was run again is another one than the recorded.
    """
    if any(decision.shares for decision in rollout.summary.decisions):
        return rollout.summary.decisions
    again = run_again(rollout, progress, attribute=True)
    if not compare_rollouts(rollout, again).is_same:
        raise NotConverged(
            "run again, this rollout ends otherwise than recorded: it is of another version of "
            "this program; "
            "run the task again with --attribute"
        )
    return again.decisions


def describe_error(decision: Decision, title: str, *, succeeds: bool) -> str:
    """The error at a decision by its parts, and the first truth with which the rollout succeeds.

    `title` is what the task's error measures; `succeeds` whether the rollout does as it is.
    """
    text = f"{decision.error_mm:.1f} mm {title}"
    if succeeds:
        return f"{text}; it succeeds: there is no failure to attribute"
    text = f"fails by {text}"
    named = [
        f"{part.share_mm:.1f} the {part.title}"
        for part in sorted(decision.shares, key=lambda share: -share.share_mm)
        if abs(part.share_mm) >= _LEAST_MM
    ]
    if named:
        text += f"; of it {', '.join(named)}"
    flips = next((part for part in decision.shares if part.succeeds), None)
    if flips is not None:
        return f"{text}; with the true {flips.title.removeprefix('generated ')} it succeeds"
    return f"{text}; it fails with the truth as well" if decision.shares else text
