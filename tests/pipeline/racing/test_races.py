from __future__ import annotations

import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.races import Bar, Timing, race, row
from pipeline.racing.plot import plot, points_of
from pipeline.racing.races import Answer, Point
from pipeline.racing.report import number, show, text

OURS, PEER = Timing(median_ms=2.0, p95_ms=3.0), Timing(median_ms=20.0, p95_ms=25.0)
POSITIVE = st.floats(1e-6, 1e6)


def claim(bar, ours_error=0.5, peer_error=5.0):
    return row("q", ours=OURS, ours_error=ours_error, unit="um", bar=bar, peer="p", peer_timing=PEER,
               peer_error=peer_error)  # fmt: skip


@pytest.mark.parametrize(
    ("bar", "holds"),
    [
        (Bar(faster=10), True),
        (Bar(faster=10.1), False),
        (Bar(ms=2), True),
        (Bar(ms=1.9), False),
        (Bar(closer=10), True),
        (Bar(closer=10.1), False),
        (Bar(error=0.5), True),
        (Bar(error=0.4), False),
        (Bar(faster=10, error=0.4), False),
        (Bar(), True),
    ],
)
def test_a_bar_holds_when_all_that_it_asks_is_met(bar, holds):
    assert claim(bar).holds is holds


def test_what_is_not_known_clears_no_bar():
    alone = row("q", ours=OURS, ours_error=math.nan, unit="", bar=Bar(faster=1))
    assert not alone.holds
    assert math.isnan(alone.ratio)
    assert not claim(Bar(error=1), ours_error=math.nan).holds


@given(ms=POSITIVE, error=POSITIVE, peer_ms=POSITIVE, peer_error=POSITIVE, faster=POSITIVE, most=POSITIVE)
def test_the_limits_of_a_bar_are_where_it_begins_to_hold(ms, error, peer_ms, peer_error, faster, most):
    bar = Bar(faster=faster, error=most)
    limit_ms, limit_error = bar.limits((peer_ms, peer_error))
    inside = (0.999 * limit_ms, 0.999 * limit_error)
    assert bar.holds(inside, (peer_ms, peer_error))
    assert not bar.holds((1.001 * limit_ms, inside[1]), (peer_ms, peer_error))
    assert not bar.holds((inside[0], 1.001 * limit_error), (peer_ms, peer_error))


def test_a_row_as_json_has_exactly_the_keys_of_a_claim_and_no_nan():
    alone = row("q", ours=OURS, ours_error=math.nan, unit="", bar=Bar(ms=3))
    keys = {"question", "peer", "ours_ms", "peer_ms", "ratio", "ours_error", "peer_error", "unit", "bar", "holds"}
    assert set(alone.as_json()) == keys | {"ours_p95_ms", "peer_p95_ms"}
    assert alone.as_json()["peer_ms"] is None
    json.dumps(alone.as_json(), allow_nan=False)


def test_methods_take_turns_forward_and_backward():
    order = []
    times = race({"a": lambda: order.append("a"), "b": lambda: order.append("b")}, runs=4)
    assert "".join(order) == "aabb" + "abbaabba"
    assert set(times) == {"a", "b"}
    assert all(0 <= t.median_ms <= t.p95_ms for t in times.values())


def test_an_answer_is_printed_with_its_verdicts_its_points_and_the_machine(capsys):
    answer = Answer(title="A title", unit="um", rows=(claim(Bar(faster=2)), claim(Bar(error=0.1))),
                    points=(Point(method="a peer", ms=1.0, error=0.0),), notes=("a note",))  # fmt: skip
    show(answer)
    printed = capsys.readouterr().out
    for words in ("A title", "2x faster", "holds", "MISSED", "a peer", "a note", "cores", "numpy"):
        assert words in printed


def test_a_row_without_a_bar_has_no_verdict():
    printed = text(Answer(title="t", unit="um", rows=(claim(Bar()),)))
    assert "no bar" in printed
    assert "holds" not in printed


@pytest.mark.parametrize(
    ("value", "words"), [(math.nan, "-"), (0.0, "0"), (0.012345, "0.0123"), (12345.6, "12346"), (1e-9, "1e-09")]
)
def test_numbers_have_three_digits_that_matter(value, words):
    assert number(value) == words


def test_points_come_from_the_rows_where_an_answer_has_none():
    other = row("in other units", ours=OURS, ours_error=1.0, unit="deg", bar=Bar())
    points = points_of(Answer(title="t", unit="um", rows=(claim(Bar()), claim(Bar()), other)))
    assert [(p.ours, p.ms, p.error) for p in points] == [(True, 2.0, 0.5), (False, 20.0, 5.0)]


def test_a_plot_is_drawn_where_there_is_something_to_draw_even_with_an_error_of_zero(tmp_path):
    exact = Answer(title="t", unit="um", rows=(claim(Bar(faster=2)),),
                   points=(Point(method="ours", ms=2.0, error=0.0, ours=True),
                           Point(method="theirs", ms=20.0, error=5.0)))  # fmt: skip
    assert plot(exact, tmp_path / "plots" / "exact.png")
    assert (tmp_path / "plots" / "exact.png").read_bytes().startswith(b"\x89PNG")
    assert [p.name for p in (tmp_path / "plots").iterdir()] == ["exact.png"]
    timed = Answer(title="t", unit="", rows=(row("q", ours=OURS, ours_error=math.nan, unit="", bar=Bar(ms=3)),))
    assert not plot(timed, tmp_path / "none.png")
    assert not (tmp_path / "none.png").exists()
