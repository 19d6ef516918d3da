"""What a live translation leaves out to keep up with a rate: the one rule, and how it is said.

The rate is the user's choice. First the pose is computed in every n-th frame only, then methods
that have a draft compute that, and where even this takes too long, frames are left out, the oldest
first.
"""

from __future__ import annotations

from dataclasses import dataclass

_POSES = (1, 2, 3, 5)  # every n-th frame has one
_USED_SHARE = 0.85  # of the workers' time; the rest is the reader's and the screen's
_DRAFT_SHARE = 0.5  # guessed time of a draft, until one was measured


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameCost:
    """Time that a worker takes for a frame, in ms."""

    stages_ms: float  # all but the pose
    draft_ms: float | None  # the same as drafts; None = not measured yet
    pose_ms: float


@dataclass(frozen=True, slots=True, kw_only=True)
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


def plan_rate(rate_hz: float, cost: FrameCost | None, n_workers: int) -> RatePlan:
    """Return the plan that leaves out least and fits the workers' time.

    Everything for best quality (0 Hz), and as long as no frame was measured.
    """
    if rate_hz == 0 or cost is None:
        return RatePlan(rate_hz=rate_hz)
    budget_ms = _USED_SHARE * 1e3 * n_workers / rate_hz
    guessed_ms = _DRAFT_SHARE * cost.stages_ms
    draft_ms = guessed_ms if cost.draft_ms is None else cost.draft_ms
    for stages_ms, draft in ((cost.stages_ms, False), (draft_ms, True)):
        for every in _POSES:
            if stages_ms + cost.pose_ms / every <= budget_ms:
                return RatePlan(rate_hz=rate_hz, pose_every=every, draft=draft)
    return RatePlan(rate_hz=rate_hz, pose_every=_POSES[-1], draft=draft_ms < cost.stages_ms)
