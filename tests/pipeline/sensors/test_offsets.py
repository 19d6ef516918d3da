"""Offsets: six numbers and a pivot are one rigid motion, for any pivot."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.core.geometry import rigid
from pipeline.core.typed_data import InvalidField, check
from pipeline.sensors.alignment import Offsets, decompose_motion, resolve_alignment
from pipeline.sensors.spec import load_sensor

ROUNDING_MM = 1e-9  # points within 300 mm, double precision
numbers = st.floats(-30.0, 30.0)
triples = st.tuples(numbers, numbers, numbers)


@given(translation=triples, rotation=triples, pivot=triples, other=triples)
def test_another_pivot_gives_the_same_motion(translation, rotation, pivot, other):
    offsets = Offsets(translation_mm=translation, rotation_deg=rotation, pivot_mm=pivot)
    points = np.array([[0.0, 0.0, 0.0], [100.0, -50.0, 80.0]])
    moved = rigid.apply(offsets.to_matrix(), points)
    assert np.allclose(
        rigid.apply(offsets.with_pivot(other).to_matrix(), points), moved, rtol=0, atol=ROUNDING_MM
    )
    assert offsets.with_pivot(other).pivot_mm == other


def test_a_rotation_keeps_the_pivot_and_a_translation_moves_it():
    offsets = Offsets(rotation_deg=(0.0, 0.0, 30.0), pivot_mm=(1.0, 2.0, 20.0))
    assert np.allclose(
        rigid.apply(offsets.to_matrix(), (1.0, 2.0, 20.0)), (1.0, 2.0, 20.0), atol=ROUNDING_MM
    )
    translated = offsets.with_axis_value("y", 0.5)
    assert np.allclose(
        rigid.apply(translated.to_matrix(), (1.0, 2.0, 20.0)), (1.0, 2.5, 20.0), atol=ROUNDING_MM
    )
    assert translated.values == (0.0, 0.5, 0.0, 0.0, 0.0, 30.0)


def test_zero_offsets_return_the_opened_alignment():
    opened = resolve_alignment(load_sensor("digit"), load_sensor("gelslim"))
    assert Offsets(pivot_mm=(1.0, 2.0, 3.0)).apply_to(opened) is opened


def test_offsets_come_after_the_opened_alignment():
    opened = resolve_alignment(load_sensor("digit"), load_sensor("gelslim"))
    offsets = Offsets(
        translation_mm=(1.0, 0.0, 0.0), rotation_deg=(0.0, 5.0, 0.0), pivot_mm=(0.0, 0.0, 19.0)
    )
    expected = offsets.to_matrix() @ opened.target_from_source
    assert np.allclose(
        offsets.apply_to(opened).target_from_source, expected, rtol=0, atol=ROUNDING_MM
    )


def test_a_motion_is_decomposed_about_the_given_pivot():
    offsets = Offsets(
        translation_mm=(0.1, -0.2, 0.3), rotation_deg=(1.0, 2.0, -3.0), pivot_mm=(4.0, 5.0, 6.0)
    )
    found = decompose_motion(offsets.to_matrix(), (4.0, 5.0, 6.0))
    assert np.allclose(found.values, offsets.values, rtol=0, atol=ROUNDING_MM)


@pytest.mark.parametrize(
    "plain",
    [
        None,
        {"translation_mm": [1, 2]},
        {"translation_mm": [1, 2, "3"], "rotation_deg": [0] * 3, "pivot_mm": [0] * 3},
        {"translation_mm": [1, 2, float("nan")], "rotation_deg": [0] * 3, "pivot_mm": [0] * 3},
    ],
)
def test_invalid_offsets_are_refused(plain):
    with pytest.raises(InvalidField, match="expected"):
        check(plain, Offsets)
