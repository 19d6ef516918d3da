from __future__ import annotations

import numpy as np
import pytest

from pipeline.core.arrays import ensure_float, freeze


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_lengths_in_a_type_that_keeps_micrometres_are_left_alone(kind):
    lengths = np.array([80.001], kind)
    assert ensure_float(lengths) is lengths


@pytest.mark.parametrize("kind", [np.float16, np.int32, np.uint8])
def test_other_types_are_widened(kind):
    widened = ensure_float(np.array([3], kind))
    assert widened.dtype == np.float32
    assert widened[0] == 3


def test_what_is_frozen_is_the_same_array_and_is_not_written_to():
    array = np.zeros(2)
    assert freeze(array) is array
    with pytest.raises(ValueError, match="read-only"):
        array[0] = 1.0
