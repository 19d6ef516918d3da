from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from pipeline.sensors.kinds import get_kind
from pipeline.stages.networks.touch_formats import (
    denormalise,
    normalise,
    resize_from_square,
    resize_to_square,
)


def test_gel_changes_are_signed_and_bubble_changes_are_toward_the_camera():
    rest = np.full((4, 5, 3), 100, np.uint8)
    assert np.allclose(get_kind("gel").compute_relative_change(rest - 51, rest), -0.2)
    depth = np.full((4, 5), 60.0, np.float32)
    pressed = depth.copy()
    pressed[1, 2] = 57.5
    pressed[0, 0] = np.nan
    moved = get_kind("bubble").compute_relative_change(pressed, depth)
    assert moved.shape == (4, 5, 1)
    assert (moved[1, 2, 0], moved[0, 0, 0]) == (2.5, 0.0)


@given(st.integers(0, 2**31))
def test_normalisation_is_invertible(seed):
    squares = np.random.default_rng(seed).normal(size=(3, 8, 8)).astype(np.float32)
    assert np.allclose(denormalise(normalise(squares, "gel"), "gel"), squares, atol=1e-6)


def test_resizing_keeps_the_mean_and_is_invertible():
    y, x = np.mgrid[:64, :96] / 32.0
    smooth = np.stack([np.sin(x + y), np.cos(y)], axis=-1).astype(np.float32)
    small = resize_to_square(smooth, 32)
    assert small.shape == (2, 32, 32)
    assert np.allclose(small.mean((1, 2)), smooth.mean((0, 1)), atol=1e-6)
    assert np.abs(resize_from_square(small, (64, 96)) - smooth)[4:-4, 4:-4].max() < 0.01
