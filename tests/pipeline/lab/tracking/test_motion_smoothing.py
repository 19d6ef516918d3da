"""Smoothed coordinates of a track."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.lab.tracking import track_recording
from pipeline.lab.tracking.track_recording import smooth_coordinates

FRAMES = np.arange(40.0)


def rms(values):
    return float(np.sqrt((values**2).mean()))


@pytest.mark.parametrize("true", [np.zeros(40), 0.3 * FRAMES])
@settings(max_examples=10)
@given(seed=st.integers(0, 1000))
def test_noise_of_rest_and_of_steady_motion_is_averaged(true, seed):
    noise = np.random.default_rng(seed).normal(0.0, 0.2, (40, 6))
    assert rms(smooth_coordinates(true[:, None] + noise) - true[:, None]) < 0.7 * rms(noise)


@settings(max_examples=10)
@given(jump=st.floats(1.0, 50.0), frame=st.integers(12, 28))
def test_an_exact_jump_stays_where_it_was_measured(jump, frame):
    true = np.where(frame <= FRAMES, jump, 0.0)[:, None]
    smoothed = smooth_coordinates(true)
    assert np.abs(smoothed - true).max() < 0.1 * jump


def test_frames_without_a_measurement_are_bridged():
    true = 0.3 * FRAMES[:, None] + np.random.default_rng(0).normal(0.0, 0.01, (40, 1))
    holed = true.copy()
    holed[15:18] = np.nan
    assert np.abs(smooth_coordinates(holed) - true).max() < 0.1


@given(phi=st.floats(0.0, 0.99), s=st.floats(1e-3, 10.0))
def test_velocities_stay_as_large_as_they_are(phi, s):
    """The variance of an Ornstein-Uhlenbeck process is the same in every frame."""
    state = (np.zeros(1), np.full(1, 2.0), np.zeros(1), np.zeros(1), np.full(1, s**2))
    x, v, xx, xv, vv = track_recording._predict(state, np.full(1, phi), np.full(1, s))
    np.testing.assert_allclose([x[0], v[0], vv[0]], [2.0, 2.0 * phi, s**2])
    np.testing.assert_allclose([xx[0], xv[0]], [s**2, phi * s**2])
