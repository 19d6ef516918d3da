from __future__ import annotations

import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.harness.plot import collect_points, plot_result
from benchmarks.harness.results import BenchmarkResult, PlotPoint
from benchmarks.harness.text_report import format_number, format_result, print_result
from benchmarks.harness.timing import Requirement, Timing, build_measurement, time_in_turns

OURS = Timing(median_ms=2.0, p95_ms=3.0)
PEER = Timing(median_ms=20.0, p95_ms=25.0)
POSITIVE = st.floats(1e-6, 1e6)


def claim(bar, ours_error=0.5, peer_error=5.0):
    return build_measurement(
        "q",
        ours=OURS,
        ours_error=ours_error,
        unit="um",
        bar=bar,
        peer="p",
        peer_timing=PEER,
        peer_error=peer_error,
    )


@pytest.mark.parametrize(
    ("bar", "holds"),
    [
        (Requirement(min_speedup=10), True),
        (Requirement(min_speedup=10.1), False),
        (Requirement(max_ms=2), True),
        (Requirement(max_ms=1.9), False),
        (Requirement(min_error_ratio=10), True),
        (Requirement(min_error_ratio=10.1), False),
        (Requirement(max_error=0.5), True),
        (Requirement(max_error=0.4), False),
        (Requirement(min_speedup=10, max_error=0.4), False),
        (Requirement(), True),
    ],
)
def test_a_bar_holds_when_all_that_it_asks_is_met(bar, holds):
    assert claim(bar).holds is holds


def test_what_is_not_known_clears_no_bar():
    alone = build_measurement(
        "q", ours=OURS, ours_error=math.nan, unit="", bar=Requirement(min_speedup=1)
    )
    assert not alone.holds
    assert math.isnan(alone.ratio)
    assert not claim(Requirement(max_error=1), ours_error=math.nan).holds


@given(
    ms=POSITIVE,
    error=POSITIVE,
    peer_ms=POSITIVE,
    peer_error=POSITIVE,
    faster=POSITIVE,
    most=POSITIVE,
)
def test_the_limits_of_a_bar_are_where_it_begins_to_hold(
    ms, error, peer_ms, peer_error, faster, most
):
    bar = Requirement(min_speedup=faster, max_error=most)
    limit_ms, limit_error = bar.compute_limits((peer_ms, peer_error))
    inside = (0.999 * limit_ms, 0.999 * limit_error)
    assert bar.is_met(inside, (peer_ms, peer_error))
    assert not bar.is_met((1.001 * limit_ms, inside[1]), (peer_ms, peer_error))
    assert not bar.is_met((inside[0], 1.001 * limit_error), (peer_ms, peer_error))


def test_a_row_as_json_has_exactly_the_keys_of_a_claim_and_no_nan():
    alone = build_measurement(
        "q", ours=OURS, ours_error=math.nan, unit="", bar=Requirement(max_ms=3)
    )
    keys = {
        "question",
        "peer",
        "ours_ms",
        "peer_ms",
        "ratio",
        "ours_error",
        "peer_error",
        "unit",
        "bar",
        "holds",
    }
    assert set(alone.as_json()) == keys | {"ours_p95_ms", "peer_p95_ms"}
    assert alone.as_json()["peer_ms"] is None
    json.dumps(alone.as_json(), allow_nan=False)


def test_methods_take_turns_forward_and_backward():
    order = []
    times = time_in_turns({"a": lambda: order.append("a"), "b": lambda: order.append("b")}, runs=4)
    assert "".join(order) == "aabb" + "abbaabba"
    assert set(times) == {"a", "b"}
    assert all(0 <= t.median_ms <= t.p95_ms for t in times.values())


def test_a_result_is_printed_with_its_verdicts_its_points_and_the_machine(capsys):
    result = BenchmarkResult(
        title="A title",
        unit="um",
        rows=(claim(Requirement(min_speedup=2)), claim(Requirement(max_error=0.1))),
        points=(PlotPoint(method="a peer", ms=1.0, error=0.0),),
        notes=("a note",),
    )
    print_result(result)
    printed = capsys.readouterr().out
    for words in ("A title", "2x faster", "holds", "MISSED", "a peer", "a note", "cores", "numpy"):
        assert words in printed


def test_a_row_without_a_bar_has_no_verdict():
    printed = format_result(BenchmarkResult(title="t", unit="um", rows=(claim(Requirement()),)))
    assert "no bar" in printed
    assert "holds" not in printed


@pytest.mark.parametrize(
    ("value", "words"),
    [(math.nan, "-"), (0.0, "0"), (0.012345, "0.0123"), (12345.6, "12346"), (1e-9, "1e-09")],
)
def test_numbers_have_three_digits_that_matter(value, words):
    assert format_number(value) == words


def test_points_come_from_the_rows_where_a_result_has_none():
    other = build_measurement(
        "in other units", ours=OURS, ours_error=1.0, unit="deg", bar=Requirement()
    )
    points = collect_points(
        BenchmarkResult(
            title="t", unit="um", rows=(claim(Requirement()), claim(Requirement()), other)
        )
    )
    assert [(p.ours, p.ms, p.error) for p in points] == [(True, 2.0, 0.5), (False, 20.0, 5.0)]


def test_a_plot_is_drawn_where_there_is_something_to_draw_even_with_an_error_of_zero(tmp_path):
    exact = BenchmarkResult(
        title="t",
        unit="um",
        rows=(claim(Requirement(min_speedup=2)),),
        points=(
            PlotPoint(method="ours", ms=2.0, error=0.0, ours=True),
            PlotPoint(method="theirs", ms=20.0, error=5.0),
        ),
    )
    assert plot_result(exact, tmp_path / "plots" / "exact.png")
    assert (tmp_path / "plots" / "exact.png").read_bytes().startswith(b"\x89PNG")
    assert [p.name for p in (tmp_path / "plots").iterdir()] == ["exact.png"]
    timed = BenchmarkResult(
        title="t",
        unit="",
        rows=(
            build_measurement(
                "q", ours=OURS, ours_error=math.nan, unit="", bar=Requirement(max_ms=3)
            ),
        ),
    )
    assert not plot_result(timed, tmp_path / "none.png")
    assert not (tmp_path / "none.png").exists()
