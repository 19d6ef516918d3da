"""What a live translation leaves out to keep up with a rate: the one rule, and how it is said.

The rate is the user's choice, of the frames shown in a second on average. First the pose is
computed in every n-th frame only, then methods that have a draft compute that, and where even this
takes too long, frames are left out, the oldest first. What was measured to save nothing is not left
out.
"""

from __future__ import annotations

import math
from collections import defaultdict, deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from statistics import median
from typing import TypeVar

from pipeline.core.frozen import frozen

T = TypeVar("T")
_POSES = (1, 2, 3, 5)  # every n-th frame has one
_USED_SHARE = 0.85  # of the workers' time; the rest is the reader's and the screen's
_EARLY_SHARE = 0.2  # of a period, by which a frame may be early: sources jitter
_BEHIND_S = 2.0  # that quick frames catch up on after slow ones
_MEASURED_FRAMES = 15  # with contact, whose times count
_WORTH_SHARE = 0.9  # of a plan's time, that one which leaves out more has at most
# guessed times of stages, as drafts and in full, over the other's, until they are measured
_DRAFT_SHARES = {True: 0.5, False: 2.0}
_LEAST_FRAMES = 5  # that tell what a plan costs: the first follows another plan's
_MEMORY_S = 20.0  # for which they do: the touch changes, and so do its times


@frozen
class RatePlan:
    """What is computed of which frames."""

    rate_hz: float = 0.0  # frames a second aimed at; 0 = best quality, as many as come out
    pose_every: int = 1
    draft: bool = False

    def describe(self) -> str:
        """Return what is left out in a few words; "" = nothing."""
        ordinal = {1: "", 2: "2nd", 3: "3rd"}.get(self.pose_every, f"{self.pose_every}th")
        parts = (
            f"pose in every {ordinal} frame" if self.pose_every > 1 else "",
            "drafts" if self.draft else "",
        )
        return ", ".join(part for part in parts if part)


Times = deque[tuple[float, float]]  # (time of the frame in s, ms that a worker took)


def _make_times() -> Times:
    return deque(maxlen=_MEASURED_FRAMES)


@dataclass(slots=True, kw_only=True)
class RateRule:
    """Decides which frames of a source are computed, and what of them, by what they have cost."""

    rate_hz: float = 0.0  # 0 = best quality
    n_workers: int = 1
    has_draft: bool = False  # whether a draft of the methods differs from what they compute
    plan: RatePlan = field(init=False)
    _due_s: float | None = field(default=None, init=False)  # of the next frame
    # draft -> of all stages but the pose; every n-th frame -> of a pose
    _stages: defaultdict[bool, Times] = field(
        default_factory=lambda: defaultdict(_make_times), init=False
    )
    _poses: defaultdict[int, Times] = field(
        default_factory=lambda: defaultdict(_make_times), init=False
    )

    def __post_init__(self) -> None:
        self.plan = RatePlan(rate_hz=self.rate_hz)

    def take(self, time_s: float) -> bool:
        """Whether a frame of this time is computed; it counts as one of the rate's if so.

        Frames that come late are caught up on, so that the rate holds on average.
        """
        if self.rate_hz:
            period_s = 1.0 / self.rate_hz
            due_s = time_s if self._due_s is None else max(self._due_s, time_s - _BEHIND_S)
            if time_s < due_s - _EARLY_SHARE * period_s:
                return False
            self._due_s = due_s + period_s
        return True

    def add_cost(
        self, plan: RatePlan, time_s: float, stages_ms: float, pose_ms: float | None
    ) -> None:
        """Learn what a frame with contact took by its plan, and plan for the next ones.

        `stages_ms` is of all but the pose, whose time is None where it was left out.
        """
        self._stages[plan.draft].append((time_s, stages_ms))
        if pose_ms is not None:
            self._poses[plan.pose_every].append((time_s, pose_ms))
        for times in (*self._stages.values(), *self._poses.values()):
            while times and times[0][0] < time_s - _MEMORY_S:
                times.popleft()
        if self.rate_hz:
            self.plan = self._choose()

    def _choose(self) -> RatePlan:
        """The plan that leaves out least and fits the workers' time, or else the cheapest one.

        As it was until enough is measured.
        """
        stages = _get_medians(self._stages)
        poses = _get_medians(self._poses)
        if not stages:
            return self.plan
        budget_ms = _USED_SHARE * 1e3 * self.n_workers / self.rate_hz
        cheapest = self.plan
        least_ms = math.inf
        for draft in (False, True) if self.has_draft else (False,):
            for every in _POSES:
                plan = replace(self.plan, draft=draft, pose_every=every)
                ms = _estimate_ms(plan, stages, poses)
                if ms <= budget_ms:
                    return plan
                if ms < _WORTH_SHARE * least_ms:
                    cheapest = plan
                    least_ms = ms
        return cheapest


K = TypeVar("K")


def _get_medians(measured: Mapping[K, Times]) -> dict[K, float]:
    """Return the median times of what was computed often enough."""
    return {
        key: median(ms for _, ms in times)
        for key, times in measured.items()
        if len(times) >= _LEAST_FRAMES
    }


def _estimate_ms(plan: RatePlan, stages: Mapping[bool, float], poses: Mapping[int, float]) -> float:
    """Return the time of a frame by a plan: as measured, or else the least that the nearest one
    tells of.

    A pose takes as long as far as the object has moved, or the same: so a plan is tried before it
    is thought to save nothing.
    """
    stages_ms = stages.get(plan.draft, _DRAFT_SHARES[plan.draft] * max(stages.values()))
    nearest = min(poses, key=lambda every: abs(every - plan.pose_every), default=1)
    return stages_ms + poses.get(nearest, 0.0) / max(nearest, plan.pose_every)


def pop_in_order(offered: deque[T], is_done: Callable[[T], bool], most_held: int) -> list[T]:
    """Take out and return, in order, what is done of the frames that were offered.

    One waits for those before it, which another worker is about to finish. Where more than
    `most_held` would wait, those before are late, and taken out as well.
    """
    shown: list[T] = []
    while offered and is_done(offered[0]):
        shown.append(offered.popleft())
    while sum(map(is_done, offered)) > most_held:
        while not is_done(offered[0]):
            offered.popleft()
        while offered and is_done(offered[0]):
            shown.append(offered.popleft())
    return shown
