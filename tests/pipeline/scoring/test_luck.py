"""Luck and bias of samples that are known to be the one or the other."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.base.errors import SettingProblem
from pipeline.evaluation.bias_variance import estimate_bias_variance

SHAPE, COUNT = (60, 80), 16
RNG = np.random.default_rng(3)
TRUE = RNG.random(SHAPE).astype(np.float32)
CONTACT = np.zeros(SHAPE, np.bool_)
CONTACT[10:50, 10:70] = True


def samples(spread_mm: np.ndarray | float, bias_mm: float) -> list[np.ndarray]:
    return [(TRUE + bias_mm + spread_mm * RNG.standard_normal(SHAPE)).astype(np.float32) for _ in range(COUNT)]


@pytest.mark.parametrize(("spread", "bias", "word"), [(0.2, 0.0, "luck"), (0.05, 0.3, "bias")])
def test_what_more_samples_would_take_away_is_told_from_what_they_would_not(spread, bias, word):
    told = estimate_bias_variance(samples(spread, bias), TRUE, CONTACT)
    assert told.rms_std_mm == pytest.approx(spread, rel=0.1)
    assert told.rms_bias_mm == pytest.approx(np.hypot(bias, spread / np.sqrt(COUNT)), rel=0.1)
    assert f"% of the square is {word}" in told.summary


def test_a_sampler_that_knows_what_it_does_not_know_lies_on_one_line():
    spread = np.linspace(0.05, 0.5, SHAPE[0] * SHAPE[1]).reshape(SHAPE)
    curve = estimate_bias_variance(samples(spread, 0.0), TRUE, CONTACT).compute_reliability_curve()
    assert len(curve) > 5
    inner = curve[1:-1]  # the ends hold those whose spread came out smallest or largest by chance
    assert inner[:, 1] * np.sqrt(COUNT) == pytest.approx(inner[:, 0], rel=0.15)


def test_without_a_truth_the_spread_alone_is_told():
    told = estimate_bias_variance(samples(0.2, 0.0), None, None)
    assert "not known" in told.summary
    assert told.bias_mm is None
    assert not len(told.compute_reliability_curve())
    with pytest.raises(SettingProblem):
        estimate_bias_variance(samples(0.2, 0.0)[:1], None, None)
