from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.core.errors import select_warnings
from pipeline.io import open_recording
from pipeline.io.inspection.synchrony import (
    ContactSignature,
    compare_signatures,
    compare_streams,
    compute_signature,
)

SAMPLE = Path(__file__).resolve().parents[4] / "sample_data" / "recordings" / "first_touch.h5"
ORDERS = 8


def moments(n, seed, *, noise=0.005):
    """The same touches recorded by two sensors, one rotated, mirrored and larger."""
    rng = np.random.default_rng(seed)
    strength = np.exp(rng.normal(0.0, 0.4, n))
    at = rng.uniform(0.2, 0.8, (n, 2))
    there = (
        (at - 0.5) @ np.array([[0.3, 0.25], [0.25, -0.3]]) + 0.5 + rng.normal(0.0, noise, (n, 2))
    )
    hard = 3.0 * strength ** rng.uniform(0.5, 1.0, n)
    return [ContactSignature(s, *p) for s, p in zip(strength, at, strict=True)], [
        ContactSignature(s, *p) for s, p in zip(hard, there, strict=True)
    ]


def test_pairs_in_order_have_no_warning_and_shuffled_ones_mostly_have():
    warned = []
    for seed in range(ORDERS):
        one, other = moments(24, seed)
        assert compare_signatures(one, other).warning is None
        shuffled = np.random.default_rng(seed + 1000).permutation(len(other))
        warned.append(compare_signatures(one, [other[k] for k in shuffled]).warning is not None)
    assert np.mean(warned) >= 0.75  # one in twenty agrees as well by chance, in either of two ways


@pytest.mark.parametrize("late", [3, -4])
def test_the_lag_of_a_late_stream_is_found(late):
    one, other = moments(40, 5)
    shifted = (one[late:], other[:-late]) if late > 0 else (one[:late], other[-late:])
    found = compare_signatures(*shifted)
    assert found.lag_frames == late
    assert f"{abs(late)} frames {'late' if late > 0 else 'early'}" in found.warning


def test_few_moments_and_a_repeated_press_give_no_result():
    one, other = moments(11, 0)
    assert compare_signatures(one, other) is None
    same = [ContactSignature(1.0 + 0.001 * k, 0.5, 0.5) for k in range(30)]
    assert compare_signatures(same, same[::-1]) is None


def test_the_place_of_a_change_is_its_strongest_region():
    change = np.zeros((60, 80), np.float32)
    change[20:24, 60:64] = 5.0
    change[40:, :30] = 1.0  # a shadow
    found = compute_signature(change)
    assert (found.x, found.y) == pytest.approx((61.5 / 80, 21.5 / 80), abs=0.02)
    assert compute_signature(np.zeros((60, 80), np.float32)).strength == 0.0


def test_streams_of_the_sample_agree_and_in_random_order_do_not():
    with closing(open_recording(SAMPLE)) as recording:
        one = recording.stream("gelslim")
        other = recording.stream("soft_bubble")
        assert compare_streams(one, other).warning is None
        order = np.random.default_rng(2).permutation(other.n_frames)
        mixed = compare_streams(one, replace(other, frame=lambda k: other.frame(int(order[k]))))
        assert select_warnings((mixed.warning,))
