"""Random things as height fields."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.simulation.reliefs import make_random_relief

N, VIEW = 96, 70.0


def drawn(seed):
    return make_random_relief(np.random.default_rng(seed), N, VIEW)


@pytest.mark.parametrize("seed", range(24))
def test_a_relief_is_finite_and_its_lowest_point_is_zero(seed):
    height = drawn(seed)
    assert height.shape == (N, N)
    assert height.dtype == np.float32
    assert height.min() == 0
    assert np.isfinite(height).all()


def test_the_same_seed_gives_the_same_relief_and_another_another():
    assert np.array_equal(drawn(3), drawn(3))
    assert not np.array_equal(drawn(3), drawn(4))


def test_flat_faces_of_all_sizes_are_among_them():
    level = np.array([np.count_nonzero(drawn(seed) < 0.5) / VIEW**2 for seed in range(120)])
    assert level.min() < 0.01
    assert level.max() > 0.4
    assert 0.05 < np.mean(level > 0.05) < 0.6
