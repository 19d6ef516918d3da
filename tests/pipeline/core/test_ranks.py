"""Medians and percentiles against numpy."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.core import arrays


@settings(max_examples=60)
@given(
    n=st.integers(1, 300),
    seed=st.integers(0, 99),
    size=st.floats(-30, 30),
    rounds=st.booleans(),
    share=st.floats(0, 1),
)
def test_medians_equal_numpys_and_percentiles_do_to_rounding(n, seed, size, rounds, share):
    rng = np.random.default_rng(seed)
    values = (rng.normal(size=n) * 10.0**size).astype(np.float32)
    values = np.round(values) if rounds else values  # ties, both signs, zeros
    where = rng.random(n) < share
    where[rng.integers(n)] = True
    assert arrays.median(values, where) == np.median(values[where])
    percent = 100.0 * share
    off = abs(arrays.percentile(values, percent) - np.percentile(values, percent))
    assert off <= 2e-7 * np.abs(values).max()


def test_order_in_memory_does_not_matter():
    image = np.arange(12, dtype=np.float32).reshape(3, 4)
    assert arrays.median(image.T) == np.median(image)
    assert arrays.median(image[:, ::2], np.ones((3, 2), np.bool_)) == np.median(image[:, ::2])
