from __future__ import annotations

import numpy as np
import pytest

from pipeline.physics.optics import compute_slopes


@pytest.mark.parametrize("shape", [(7, 9), (2, 2), (3, 2)])
def test_slopes_are_differences_of_the_neighbours_one_sided_at_the_border(shape):
    height = np.random.default_rng(0).normal(size=shape)
    down, right = np.gradient(height, 0.05)
    for found, true in zip(compute_slopes(height, 0.05), (right, down), strict=True):
        np.testing.assert_allclose(found, true, atol=1e-4)
        assert found.dtype == np.float32


def test_a_height_of_one_row_slopes_along_it_alone():
    right, down = compute_slopes(np.array([[0.0, 1.0, 4.0]]), 0.5)
    np.testing.assert_array_equal(right, [[2.0, 4.0, 6.0]])
    assert not down.any()
