"""A benchmark run against an earlier one: only what got worse is reported."""

from __future__ import annotations

import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.harness.command import build_report
from benchmarks.harness.regressions import (
    REGRESSION_FACTOR,
    MeasurementKey,
    collect_measurements,
    find_regressions,
    read_measurements,
)
from benchmarks.harness.results import BenchmarkResult
from benchmarks.harness.runner import Benchmark, BenchmarkRun
from benchmarks.harness.timing import Requirement, Timing, build_measurement
from pipeline.core.errors import FileProblem

POSITIVE = st.floats(1e-6, 1e6)
NO_BAR = Requirement()
KEY = MeasurementKey(benchmark="speed", claim="q", baseline="", unit="mm")


def claim(ms=10.0, error=1.0, bar=NO_BAR, peer_ms=None, name="q"):
    peer = (
        {}
        if peer_ms is None
        else {"peer": "p", "peer_timing": Timing(median_ms=peer_ms, p95_ms=peer_ms)}
    )
    return build_measurement(
        name, ours=Timing(median_ms=ms, p95_ms=ms), ours_error=error, unit="mm", bar=bar, **peer
    )


def regressions(old, new, key=KEY):
    return find_regressions({key: old}, {key: new}, ["speed"])


@given(
    old=POSITIVE, times=st.floats(0.01, 100).filter(lambda t: abs(t / REGRESSION_FACTOR - 1) > 1e-6)
)
def test_a_tenth_is_allowed_and_no_more_of_time_and_of_error(old, times):
    assert bool(regressions(claim(ms=old), claim(ms=old * times))) is (times > REGRESSION_FACTOR)
    assert bool(regressions(claim(error=old), claim(error=old * times))) is (
        times > REGRESSION_FACTOR
    )


@given(
    ms=POSITIVE,
    busy=st.floats(1.0, 50.0),
    times=st.floats(0.01, 100).filter(lambda t: abs(t / REGRESSION_FACTOR - 1) > 1e-6),
)
def test_a_busy_machine_is_no_regression_when_a_baseline_runs_too(ms, busy, times):
    old = claim(ms=ms, peer_ms=7 * ms)
    new = claim(ms=ms * busy * times, peer_ms=7 * ms * busy)
    assert bool(regressions(old, new)) is (times > REGRESSION_FACTOR)


def test_a_requirement_that_is_no_longer_met_is_reported_however_close():
    bar = Requirement(max_ms=10.0)
    (sentence,) = regressions(claim(bar=bar), claim(ms=10.01, bar=bar))
    assert sentence == "speed: q: no longer holds (at most 10 ms)"
    assert regressions(claim(ms=10.01, bar=bar), claim(ms=10.02, bar=bar)) == []


def test_a_row_that_is_gone_and_an_error_that_is_no_number_any_more_are_regressions():
    assert find_regressions({KEY: claim()}, {}, ["speed"]) == [
        "speed: q: there is no such row any more"
    ]
    assert find_regressions({KEY: claim()}, {}, ["another benchmark"]) == []
    assert regressions(claim(error=0.5), claim(error=math.nan)) == ["speed: q: error 0.5 -> - mm"]
    assert regressions(claim(error=0.0), claim(error=1e-9)) == ["speed: q: error 0 -> 1e-09 mm"]
    assert regressions(claim(error=math.nan), claim(error=math.nan)) == []


def measured(tmp_path, name, *rows):
    benchmark = Benchmark(name=name, summary="", needs="", path=tmp_path / f"{name}.py")
    return BenchmarkRun(
        benchmark=benchmark,
        result=BenchmarkResult(title="", unit="mm", rows=rows),
        problem="",
        seconds=0.0,
    )


def test_what_was_written_is_read_again_as_the_same_rows(tmp_path):
    done = [
        measured(tmp_path, "a", claim(), claim(error=math.nan, name="r")),
        measured(tmp_path, "b", claim(peer_ms=3.0)),
    ]
    path = tmp_path / "bench.json"
    path.write_text(json.dumps(build_report({}, done)))
    before = read_measurements(path)
    now = collect_measurements(done)
    assert list(before) == list(now)
    assert [key.benchmark for key in before] == ["a", "a", "b"]
    assert find_regressions(before, now, ["a", "b"]) == []
    assert find_regressions(now, before, ["a", "b"]) == []


@pytest.mark.parametrize(
    "text", ["", "[]", "{}", '{"questions": [], "rows": [{}]}', '{"questions": 3, "rows": []}']
)
def test_another_file_is_refused_in_words(tmp_path, text):
    path = tmp_path / "other.json"
    path.write_text(text)
    with pytest.raises(FileProblem, match="no result of 'tactoscope bench --json'"):
        read_measurements(path)
    with pytest.raises(FileProblem, match="cannot read the earlier run"):
        read_measurements(tmp_path / "none.json")
