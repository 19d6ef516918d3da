"""The time budget: medians of what was computed, and the smallest skip that reaches a rate."""

from __future__ import annotations

from itertools import combinations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.engine.graph import Method, StageResult
from pipeline.engine.time_budget import StageClock, TimeBudget

READS = {"depth": ("frame",), "cloud": ("depth",), "touch": ("cloud", "depth"), "pose": ("depth", "mesh")}
METHODS = [Method(stage=s, name="m", title=s, run=lambda: None, params=int, reads=r) for s, r in READS.items()]


def _result(number: int, ms: float, state: str = "computed") -> StageResult:
    method = METHODS[number]
    return StageResult(name=method.stage, method=method, output=None, state=state, ms=ms, notes=(), digest="")  # type: ignore[arg-type]


@given(st.lists(st.floats(0.1, 200.0), min_size=4, max_size=4), st.floats(1.0, 100.0))
def test_no_smaller_skip_reaches_the_rate(times_ms, rate_hz):
    budget = TimeBudget(times_ms=dict(zip(READS, times_ms, strict=True)), reads=READS)
    skip = budget.find_skip(rate_hz)
    closed = [  # all sets that hold every stage that depends on one of theirs, and leave one
        chosen for n in range(4) for names in combinations(READS, n)
        if (chosen := frozenset[str]().union(*map(budget.find_dependents, names))) == frozenset(names)
    ]  # fmt: skip
    enough = [chosen for chosen in closed if budget.without(chosen).rate_hz >= rate_hz]
    if skip is None:
        assert not enough
    else:
        assert skip in enough
        assert len(skip) == min(map(len, enough))
        assert sum(budget.get_share(name) for name in READS) == pytest.approx(1.0)


def test_only_computed_results_with_the_present_parameters_count():
    clock = StageClock()
    for ms in (10.0, 30.0, 20.0):
        clock.record(_result(0, ms), 1)
    clock.record(_result(0, 0.01, "cached"), 1)
    clock.record(_result(3, 5.0, "skipped"), 1)
    assert dict(clock.compute_budget(METHODS).times_ms) == {"depth": 20.0}
    clock.record(_result(0, 7.0), 2)  # other parameters, another time
    assert dict(clock.compute_budget(METHODS).times_ms) == {"depth": 7.0}
