"""Bias and variance of samples with known bias and standard deviation."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.base.errors import SettingProblem
from pipeline.evaluation.seed_comparison import estimate_bias_variance

SHAPE, COUNT = (60, 80), 16
RNG = np.random.default_rng(3)
TRUE = RNG.random(SHAPE).astype(np.float32)
CONTACT = np.zeros(SHAPE, np.bool_)
CONTACT[10:50, 10:70] = True


def samples(spread_mm: np.ndarray | float, bias_mm: float) -> list[np.ndarray]:
    return [(TRUE + bias_mm + spread_mm * RNG.standard_normal(SHAPE)).astype(np.float32) for _ in range(COUNT)]


@pytest.mark.parametrize(("spread", "bias", "word"), [(0.2, 0.0, "variance"), (0.05, 0.3, "bias")])
def test_bias_and_variance_are_separated(spread, bias, word):
    statistics = estimate_bias_variance(samples(spread, bias), TRUE, CONTACT)
    assert statistics.rms_std_mm == pytest.approx(spread, rel=0.1)
    assert statistics.rms_bias_mm == pytest.approx(np.hypot(bias, spread / np.sqrt(COUNT)), rel=0.1)
    assert f"% of the square is {word}" in statistics.summary


def test_a_calibrated_sampler_lies_on_the_diagonal():
    spread = np.linspace(0.05, 0.5, SHAPE[0] * SHAPE[1]).reshape(SHAPE)
    curve = estimate_bias_variance(samples(spread, 0.0), TRUE, CONTACT).compute_reliability_curve()
    assert len(curve) > 5
    inner = curve[1:-1]  # the ends hold pixels with the smallest or largest standard deviation by chance
    assert inner[:, 1] * np.sqrt(COUNT) == pytest.approx(inner[:, 0], rel=0.15)


def test_without_ground_truth_only_the_variance_is_known():
    statistics = estimate_bias_variance(samples(0.2, 0.0), None, None)
    assert "not known" in statistics.summary
    assert statistics.bias_mm is None
    assert not len(statistics.compute_reliability_curve())
    with pytest.raises(SettingProblem):
        estimate_bias_variance(samples(0.2, 0.0)[:1], None, None)
