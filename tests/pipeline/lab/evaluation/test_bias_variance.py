"""Bias and variance of samples with known bias and standard deviation."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.lab.evaluation.grid_comparison import measure_spread

SHAPE = (60, 80)
COUNT = 16
RNG = np.random.default_rng(3)
TRUE = RNG.random(SHAPE).astype(np.float32)
CONTACT = np.zeros(SHAPE, np.bool_)
CONTACT[10:50, 10:70] = True


def samples(spread_mm: np.ndarray | float, bias_mm: float) -> list[np.ndarray]:
    return [
        (TRUE + bias_mm + spread_mm * RNG.standard_normal(SHAPE)).astype(np.float32)
        for _ in range(COUNT)
    ]


@pytest.mark.parametrize(("spread", "bias", "word"), [(0.2, 0.0, "variance"), (0.05, 0.3, "bias")])
def test_bias_and_variance_are_separated(spread, bias, word):
    measured = measure_spread(samples(spread, bias), TRUE, CONTACT)
    assert measured.std_mm == pytest.approx(spread, rel=0.1)
    assert measured.bias_mm == pytest.approx(np.hypot(bias, spread / np.sqrt(COUNT)), rel=0.1)
    assert f"% of the square is {word}" in measured.summary


def test_without_ground_truth_only_the_variance_is_known():
    measured = measure_spread(samples(0.2, 0.0), None, None)
    assert "not known" in measured.summary
    assert np.isnan(measured.bias_mm)


def test_equal_samples_are_named():
    assert "every seed gives the same touch" in measure_spread([TRUE, TRUE], TRUE, CONTACT).summary
