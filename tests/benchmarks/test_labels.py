from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.harness.plot_labels import _meet, _room

SPANS = st.tuples(st.integers(0, 20), st.integers(1, 6)).map(lambda s: (s[0], s[0] + s[1]))


@given(SPANS, SPANS, SPANS, SPANS)
def test_boxes_meet_when_they_have_a_cell_in_common(ax, ay, bx, by):
    cells = [{(x, y) for x in range(*xs) for y in range(*ys)} for xs, ys in ((ax, ay), (bx, by))]
    boxes = [(xs[0], ys[0], xs[1], ys[1]) for xs, ys in ((ax, ay), (bx, by))]
    assert _meet(*boxes) is bool(cells[0] & cells[1])


@pytest.mark.parametrize(
    "taken", [[], [(105, 90, 400, 110)], [(105, 60, 400, 160)], [(0, 60, 95, 160), (105, 0, 400, 140)]]
)
def test_a_label_is_placed_next_to_its_point_without_overlap(taken):
    dx, dy = _room(100, 100, 60, 12, taken, (0, 0, 300, 300))
    box = (100 + dx, 100 + dy - 6, 100 + dx + 60, 100 + dy + 6)
    assert not any(_meet(box, other) for other in taken)
    assert 0 <= box[0] < box[2] <= 300
    assert 0 <= box[1] < box[3] <= 300
    assert (dx, dy) == (10.0, 0.0) or taken
