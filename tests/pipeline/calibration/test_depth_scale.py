from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.stages.depth.ball_calibration import fit_depth_scale

SHAPE = (240, 320)
RATIO = st.floats(0.7, 1.4)


def place(count: int, seed: int) -> Any:
    return np.random.default_rng(seed).uniform((20.0, 20.0), (300.0, 220.0), (count, 2)).T


@given(RATIO, st.integers(10, 20), st.integers(0, 99))
def test_an_error_that_all_presses_share_is_removed_the_more_of_them_there_are(ratio, count, seed):
    x, y = place(count, seed)
    for n, left_share in ((1, 0.5), (count, 0.15)):
        scale = fit_depth_scale(x[:n], y[:n], np.full(n, ratio), SHAPE)
        assert (
            abs(np.log(scale.factors).mean() - np.log(ratio))
            <= left_share * abs(np.log(ratio)) + 1e-6
        )


def test_presses_correct_the_places_near_them():
    x = np.array([60.0, 70.0, 50.0, 260.0, 270.0, 250.0])
    y = np.array([60.0, 120.0, 180.0] * 2)
    scale = fit_depth_scale(x, y, np.array([1.2] * 3 + [0.85] * 3), SHAPE)
    assert scale.factors[8, 2] == pytest.approx(1.2, rel=0.05)
    assert scale.factors[8, 13] == pytest.approx(0.85, rel=0.05)
    assert np.sqrt(np.mean(scale.errors**2)) < 0.6 * np.sqrt(np.mean(np.log([1.2, 0.85]) ** 2))


@given(st.integers(0, 99))
def test_errors_that_no_place_explains_scale_depth_by_less_than_they_are(seed):
    x, y = place(12, seed)
    ratio = np.exp(np.random.default_rng(seed).permutation([0.15, -0.15] * 6))
    logs = np.log(fit_depth_scale(x, y, ratio, SHAPE).factors)
    assert np.sqrt(np.mean(logs**2)) < 0.15


def test_unmeasured_presses_are_left_out_and_none_give_no_scale():
    x, y = place(5, 0)
    known = np.array([1.2, np.nan, 1.2, 1.1, np.nan])
    some = fit_depth_scale(x, y, known, SHAPE)
    others = fit_depth_scale(x[[0, 2, 3]], y[[0, 2, 3]], known[[0, 2, 3]], SHAPE)
    assert np.array_equal(some.factors, others.factors)
    assert fit_depth_scale(x, y, np.full(5, np.nan), SHAPE) is None
