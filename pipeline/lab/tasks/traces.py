"""A recorded rollout against time: contact force, commands and motion, and each tick in words."""

import numpy as np

from pipeline.lab.tasks.task import RecordedRollout
from pipeline.views.view import StepCurve

_DIGITS = 6  # of a curve: rounding is no motion
FORCE = "force"
COMMAND = "command"
MOTION = "motion"
GAP = "deviation"


def make_traces(rollout: RecordedRollout) -> tuple[StepCurve, ...]:
    """One curve per quantity, one value per tick.

    The force is the contact force on the object; command and motion are the ways of the commanded
    hand and of the hand from the first command; the deviation is between the two.
    """
    begin = rollout.commanded[0, :3, 3]
    commanded = rollout.commanded[:, :3, 3]
    moved = rollout.world_from_hand[:, :3, 3]
    values = (
        (FORCE, "N", np.linalg.norm(rollout.force_n, axis=1)),
        (COMMAND, "mm", np.linalg.norm(commanded - begin, axis=1)),
        (MOTION, "mm", np.linalg.norm(moved - begin, axis=1)),
        (GAP, "mm", np.linalg.norm(commanded - moved, axis=1)),
    )
    return tuple(
        StepCurve(name=name, unit=unit, values=tuple(one.round(_DIGITS).tolist()))
        for name, unit, one in values
    )


def describe_tick(rollout: RecordedRollout, tick: int) -> str:
    """Number, time, force and decision of a tick."""
    force_n = float(np.linalg.norm(rollout.force_n[tick]))
    text = f"tick {tick} of {rollout.n_ticks}, {rollout.time_s[tick]:.2f} s, {force_n:.1f} N"
    decisions = [k for k, decision in enumerate(rollout.summary.decisions) if decision.tick == tick]
    return text + "".join(f", decision {k}" for k in decisions)
