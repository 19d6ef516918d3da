"""Offsets: six numbers and a pivot are one rigid motion, whatever point it is told about."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.geometry import rigid
from pipeline.sensors.alignment import resolve_alignment
from pipeline.sensors.offsets import Offsets, decompose_motion, parse_offsets
from pipeline.sensors.spec import load_sensor

ROUNDING_MM = 1e-9  # points within 300 mm, double precision
numbers = st.floats(-30.0, 30.0)
triples = st.tuples(numbers, numbers, numbers)


@given(shift=triples, turn=triples, pivot=triples, other=triples)
def test_a_motion_told_about_another_point_is_the_same_motion(shift, turn, pivot, other):
    offsets = Offsets(translation_mm=shift, rotation_deg=turn, pivot_mm=pivot)
    points = np.array([[0.0, 0.0, 0.0], [100.0, -50.0, 80.0]])
    moved = rigid.apply(offsets.to_matrix(), points)
    assert np.allclose(rigid.apply(offsets.with_pivot(other).to_matrix(), points), moved, rtol=0, atol=ROUNDING_MM)
    assert offsets.with_pivot(other).pivot_mm == other


def test_a_turn_leaves_the_pivot_and_a_shift_moves_it():
    offsets = Offsets(rotation_deg=(0.0, 0.0, 30.0), pivot_mm=(1.0, 2.0, 20.0))
    assert np.allclose(rigid.apply(offsets.to_matrix(), (1.0, 2.0, 20.0)), (1.0, 2.0, 20.0), atol=ROUNDING_MM)
    shifted = offsets.with_axis_value("y", 0.5)
    assert np.allclose(rigid.apply(shifted.to_matrix(), (1.0, 2.0, 20.0)), (1.0, 2.5, 20.0), atol=ROUNDING_MM)
    assert shifted.values == (0.0, 0.5, 0.0, 0.0, 0.0, 30.0)


def test_no_offsets_leave_the_opened_alignment_itself():
    opened = resolve_alignment(load_sensor("digit"), load_sensor("gelslim"))
    assert Offsets(pivot_mm=(1.0, 2.0, 3.0)).apply_to(opened) is opened


def test_offsets_come_after_the_opened_alignment():
    opened = resolve_alignment(load_sensor("digit"), load_sensor("gelslim"))
    offsets = Offsets(translation_mm=(1.0, 0.0, 0.0), rotation_deg=(0.0, 5.0, 0.0), pivot_mm=(0.0, 0.0, 19.0))
    expected = offsets.to_matrix() @ opened.target_from_source
    assert np.allclose(offsets.apply_to(opened).target_from_source, expected, rtol=0, atol=ROUNDING_MM)


def test_a_found_motion_is_told_in_degrees_about_the_point_asked_for():
    offsets = Offsets(translation_mm=(0.1, -0.2, 0.3), rotation_deg=(1.0, 2.0, -3.0), pivot_mm=(4.0, 5.0, 6.0))
    found = decompose_motion(offsets.to_matrix(), (4.0, 5.0, 6.0))
    assert np.allclose(found.values, offsets.values, rtol=0, atol=ROUNDING_MM)


@pytest.mark.parametrize(
    "plain",
    [None, {}, {"translation_mm": [1, 2]}, {"translation_mm": [1, 2, "3"], "rotation_deg": [0] * 3, "pivot_mm": [0] * 3},
     {"translation_mm": [1, 2, float("nan")], "rotation_deg": [0] * 3, "pivot_mm": [0] * 3}],
)  # fmt: skip
def test_what_is_no_offsets_is_refused(plain):
    with pytest.raises(ValueError, match="must be"):
        parse_offsets(plain)
