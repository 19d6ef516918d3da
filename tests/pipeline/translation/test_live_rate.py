"""The rule of a live translation's rate, on a simulated clock: a lower rate never shows fewer."""

from collections import deque
from dataclasses import dataclass
from itertools import pairwise

import pytest

from pipeline.translation.live_rate import RatePlan, RateRule, pop_in_order

SOURCE_HZ = 30.0
N_WORKERS = 2
SECONDS = 32.0
QUIET_S = 12.0  # until the rule has learnt


@dataclass(frozen=True)
class Cost:
    """What a frame takes, in ms."""

    untouched: float = 10.0
    stages: float = 100.0
    draft: float = 100.0
    followed: float = 15.0  # a pose from that of the frame before
    searched: float = 80.0  # one after more than `follows_s`
    follows_s: float = 0.15

    def measure(self, plan, gap_s):
        stages_ms = self.draft if plan.draft else self.stages
        return stages_ms, self.followed if gap_s <= self.follows_s else self.searched


@dataclass(frozen=True)
class Offered:
    done_s: float
    time_s: float
    plan: RatePlan
    ms: tuple | None  # of stages and pose


def simulate(rate_hz, cost, touched_share=0.6, has_draft=False):
    """(frames shown a second, plans of the last frames) of workers that take the newest frame."""
    rule = RateRule(rate_hz=rate_hz, n_workers=N_WORKERS, has_draft=has_draft)
    offered = deque()
    free_s = [0.0] * N_WORKERS
    n_taken = n_shown = 0
    newest = -1
    last_pose_s = shown_s = -1e9
    plans = []
    for tick in range(round(SECONDS * 500)):
        now_s = 2e-3 * tick
        for one in pop_in_order(offered, lambda x, now_s=now_s: x.done_s <= now_s, N_WORKERS - 1):
            assert one.time_s > shown_s, "in order"
            shown_s = one.time_s
            n_shown += one.time_s > QUIET_S
            if one.ms is not None:
                rule.add_cost(one.plan, one.time_s, *one.ms)
        number = int(now_s * SOURCE_HZ)
        worker = free_s.index(min(free_s))
        if number == newest or free_s[worker] > now_s:
            continue
        newest = number
        time_s = number / SOURCE_HZ
        if not rule.take(time_s):
            continue
        ms = None
        total_ms = cost.untouched
        if time_s * 0.5 % 1.0 < touched_share:
            with_pose = n_taken % rule.plan.pose_every == 0
            stages_ms, pose_ms = cost.measure(rule.plan, time_s - last_pose_s)
            last_pose_s = time_s if with_pose else last_pose_s
            ms = stages_ms, pose_ms if with_pose else None
            total_ms = stages_ms + (pose_ms if with_pose else 0.0)
            if time_s > QUIET_S:
                plans.append(rule.plan)
        n_taken += 1
        free_s[worker] = now_s + 1e-3 * total_ms
        offered.append(Offered(free_s[worker], time_s, rule.plan, ms))
    return n_shown / (SECONDS - QUIET_S), plans


COSTS = [
    Cost(),
    Cost(stages=60.0),
    Cost(stages=250.0, draft=250.0),
    Cost(stages=400.0, searched=20.0),
    Cost(stages=130.0, follows_s=0.05),  # poses that are left out cost as much
    Cost(stages=130.0, followed=80.0),
    Cost(stages=300.0, draft=80.0),
]


@pytest.mark.parametrize("cost", COSTS)
@pytest.mark.parametrize("touched_share", [0.0, 0.6, 1.0])
def test_a_rate_is_reached_wherever_best_quality_reaches_it(cost, touched_share):
    best_hz, _ = simulate(0.0, cost, touched_share)
    for rate_hz in (10.0, 15.0, 20.0, 25.0, 30.0):
        shown_hz, _ = simulate(rate_hz, cost, touched_share, has_draft=cost.draft < cost.stages)
        assert shown_hz >= 0.9 * min(rate_hz, best_hz)
        assert shown_hz <= 1.05 * rate_hz


def test_what_is_left_out_makes_frames_that_best_quality_lacks():
    by_pose = Cost(stages=60.0, followed=60.0)
    by_draft = Cost(stages=300.0, draft=70.0)
    for cost in (by_pose, by_draft):
        best_hz, _ = simulate(0.0, cost, 1.0)
        shown_hz, plans = simulate(20.0, cost, 1.0, has_draft=True)
        assert best_hz < 18.0
        assert shown_hz > 19.0
        assert plans[-1].describe()


def test_nothing_is_left_out_that_saves_nothing():
    """Poses that are searched anew where they were left out, and drafts as slow as the whole."""
    cost = Cost(stages=150.0, draft=150.0, followed=5.0, searched=300.0, follows_s=0.2)
    _, plans = simulate(15.0, cost, 1.0, has_draft=True)
    kept = [plan for plan in plans if not plan.describe()]
    assert len(kept) > 0.8 * len(plans)


def test_a_rule_without_a_rate_takes_and_computes_everything():
    rule = RateRule()
    for k in range(100):
        assert rule.take(0.01 * k)
        rule.add_cost(rule.plan, 0.01 * k, 500.0, 200.0)
    assert rule.plan == RatePlan()


def test_frames_of_a_jittering_source_are_spread_evenly():
    rule = RateRule(rate_hz=20.0)
    taken = [k for k in range(300) if rule.take(k / 30.0 + 0.003 * (-1) ** k)]
    assert len(taken) == pytest.approx(200, abs=2)
    assert max(b - a for a, b in pairwise(taken)) <= 2


def test_what_is_left_out_is_said():
    assert RatePlan().describe() == ""
    assert RatePlan(pose_every=2).describe() == "pose in every 2nd frame"
    assert RatePlan(pose_every=5, draft=True).describe() == "pose in every 5th frame, drafts"
