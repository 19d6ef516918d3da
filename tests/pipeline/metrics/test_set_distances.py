from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.linalg import sqrtm

from pipeline.metrics.set_distances import MIN_TOUCHES, compare_halves, compute_floor, frechet_distance, kernel_distance


def sets(n=60, d=6, shift=0.0, seed=0):
    rng = np.random.default_rng(seed)
    mix = rng.normal(size=(d, d))
    return rng.normal(size=(n, d)) @ mix, rng.normal(size=(n + 5, d)) @ (0.7 * mix) + shift


def test_frechet_is_the_textbook_distance():
    a, b = sets(shift=0.3)
    gap = a.mean(0) - b.mean(0)
    s, t = np.cov(a.T), np.cov(b.T)
    expected = gap @ gap + np.trace(s + t - 2 * np.real(sqrtm(s @ t)))
    assert frechet_distance(a, b) == pytest.approx(expected, rel=1e-8)


def test_frechet_of_fewer_touches_than_features_is_a_number_and_0_for_the_same_set():
    a = np.random.default_rng(2).normal(size=(8, 32))
    assert frechet_distance(a, a) == pytest.approx(0.0, abs=1e-9)
    assert frechet_distance(a, a + 2.0) == pytest.approx(4.0 * 32, rel=1e-9)


def test_the_kernel_distance_has_no_bias_of_its_own_and_sees_a_shift():
    rng = np.random.default_rng(3)
    same = [kernel_distance(rng.normal(size=(20, 4)), rng.normal(size=(20, 4))) for _ in range(400)]
    assert abs(np.mean(same)) < 3 * np.std(same) / math.sqrt(len(same))
    assert kernel_distance(rng.normal(size=(20, 4)), rng.normal(size=(20, 4)) + 1.5) > np.max(same)


def test_too_few_touches_have_no_distance():
    few = np.ones((MIN_TOUCHES - 1, 3))
    assert math.isnan(frechet_distance(few, few))
    assert math.isnan(kernel_distance(few, few))


def test_what_is_made_perfectly_is_as_far_as_two_halves_of_the_truth():
    true = np.random.default_rng(4).normal(size=(40, 5))
    assert compare_halves(frechet_distance, true, true) == pytest.approx(
        compute_floor(frechet_distance, true), rel=1e-9
    )
    assert compare_halves(frechet_distance, true + 3.0, true) > 10 * compute_floor(frechet_distance, true)
