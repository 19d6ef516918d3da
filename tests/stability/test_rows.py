"""The matrix itself: a stage that refuses what it used to answer is noticed."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.core.errors import ShapeError
from tests.stability import rows
from tests.stability.checks import outcome


@pytest.fixture(autouse=True)
def own_tallies(monkeypatch):
    monkeypatch.setattr(rows, "TALLIES", {})


def refuse(_):
    raise ShapeError("no")


@pytest.mark.parametrize(
    ("bound", "stage", "passes"),
    [
        (0.0, abs, True),
        (0.0, refuse, False),
        (0.5, abs, True),
        (0.5, refuse, False),
        (1.0, refuse, True),
    ],
)
def test_a_row_fails_when_more_is_refused_than_is_usual(bound, stage, passes):
    @rows.row(0, "a row of its own", refused=bound)
    @given(st.integers())
    def case(value):
        outcome(stage, value)

    if passes:
        case()
    else:
        with pytest.raises(AssertionError, match="were refused, where"):
            case()
    (tally,) = rows.TALLIES.values()
    assert (tally.asked, tally.refused) == (tally.cases, tally.cases if stage is refuse else 0)


def test_an_outcome_outside_of_a_row_counts_for_none():
    assert outcome(refuse, 0) == (None, "no")
    assert rows.TALLIES == {}
