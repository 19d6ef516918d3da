from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.linalg import sqrtm

from pipeline.lab.evaluation.table_rows import (
    MIN_TOUCHES,
    compare_halves,
    frechet_distance,
    kernel_distance,
)


def sets(n=60, d=6, shift=0.0, seed=0):
    rng = np.random.default_rng(seed)
    mix = rng.normal(size=(d, d))
    return rng.normal(size=(n, d)) @ mix, rng.normal(size=(n + 5, d)) @ (0.7 * mix) + shift


def test_frechet_is_the_textbook_distance():
    a, b = sets(shift=0.3)
    gap = a.mean(0) - b.mean(0)
    s = np.cov(a.T)
    t = np.cov(b.T)
    expected = gap @ gap + np.trace(s + t - 2 * np.real(sqrtm(s @ t)))
    assert frechet_distance(a, b) == pytest.approx(expected, rel=1e-8)


def test_frechet_of_fewer_touches_than_features_is_a_number_and_0_for_the_same_set():
    a = np.random.default_rng(2).normal(size=(8, 32))
    assert frechet_distance(a, a) == pytest.approx(0.0, abs=1e-9)
    assert frechet_distance(a, a + 2.0) == pytest.approx(4.0 * 32, rel=1e-9)


def test_the_kernel_distance_is_the_u_statistic_of_paired_rows():
    """Against the definition written as loops.

    Scaled features give torchmetrics' kernel with gamma = 1 / scale.
    """
    a, b = sets(n=9, d=4, shift=0.4)
    a = a[:9]
    b = b[:9]
    scale = sum(row @ row for row in b) / 9
    terms = [
        (x @ y / scale + 1) ** 3
        + (u @ v / scale + 1) ** 3
        - (x @ v / scale + 1) ** 3
        - (y @ u / scale + 1) ** 3
        for i, (x, u) in enumerate(zip(a, b, strict=True))
        for j, (y, v) in enumerate(zip(a, b, strict=True))
        if i != j
    ]
    assert kernel_distance(a, b) == pytest.approx(np.mean(terms), rel=1e-9)
    assert kernel_distance(10 * a, 10 * b) == pytest.approx(kernel_distance(a, b), rel=1e-9)


def test_the_kernel_distance_has_no_bias_of_its_own_and_sees_a_shift():
    rng = np.random.default_rng(3)
    same = [kernel_distance(rng.normal(size=(20, 4)), rng.normal(size=(20, 4))) for _ in range(400)]
    assert abs(np.mean(same)) < 3 * np.std(same) / math.sqrt(len(same))
    assert kernel_distance(rng.normal(size=(20, 4)), rng.normal(size=(20, 4)) + 1.5) > np.max(same)


def test_equal_sets_have_no_kernel_distance_however_few_objects_they_hold():
    objects = np.repeat(np.random.default_rng(5).normal(size=(4, 6)), 3, axis=0)
    assert kernel_distance(objects, objects) == pytest.approx(0.0, abs=1e-12)


def test_too_few_touches_have_no_distance():
    few = np.ones((MIN_TOUCHES - 1, 3))
    assert math.isnan(frechet_distance(few, few))
    assert math.isnan(kernel_distance(few, few))


def test_what_is_made_perfectly_is_as_far_as_two_halves_of_the_truth():
    true = np.random.default_rng(4).normal(size=(40, 5))
    floor = compare_halves(frechet_distance, true, true)
    assert floor == pytest.approx(frechet_distance(true[0::2], true[1::2]), rel=1e-9)
    assert compare_halves(frechet_distance, true + 3.0, true) > 10 * floor
