"""Frames of two streams are paired by their times."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.core.errors import SettingProblem, StageWarning
from pipeline.core.values.frames import Stream, TactileFrame, Truth
from pipeline.core.values.pairing import NO_PARTNER, follow, pair_frames

IMAGE = np.zeros((2, 2, 3), np.uint8)


def make_stream(name, times_s, n=None):
    times = None if times_s is None else np.asarray(times_s, np.float64)
    return Stream(
        name=name,
        sensor=name,
        n_frames=len(times) if n is None else n,
        times_s=times,
        frame=lambda k: TactileFrame(
            sensor=name, image=IMAGE, reference=None, index=k, origin=f"{name} {k}"
        ),
        truth=lambda k: Truth(force_n=np.array([0.0, 0.0, float(k)])),
    )


@given(
    kept=st.lists(st.booleans(), min_size=2, max_size=40).filter(lambda kept: sum(kept) > 1),
    rate_hz=st.floats(0.5, 1000.0),
    shift=st.floats(-0.3, 0.3),
    seed=st.integers(0, 99),
)
def test_lost_frames_shift_no_other_pair(kept, rate_hz, shift, seed):
    """Two cameras of one rate, out of phase and jittering by less than a fifth of an interval.

    One loses frames.
    """
    rng = np.random.default_rng(seed)
    n = len(kept)
    numbers = np.flatnonzero(kept)
    times = (np.arange(n) + rng.uniform(-0.04, 0.04, n)) / rate_hz
    other = ((np.arange(n) + shift + rng.uniform(-0.04, 0.04, n)) / rate_hz)[numbers]
    pairs = pair_frames(make_stream("one", times), make_stream("other", other))
    wanted = np.full(n, NO_PARTNER)
    wanted[numbers] = np.arange(len(numbers))
    assert pairs.partners.tolist() == wanted.tolist()
    assert bool(pairs.note) == (len(numbers) < n)
    back = pair_frames(make_stream("other", other), make_stream("one", times))
    assert back.partners.tolist() == numbers.tolist()


@given(n=st.integers(3, 60), seed=st.integers(0, 99))
def test_no_frame_is_the_partner_of_two(n, seed):
    rng = np.random.default_rng(seed)
    one, other = (make_stream(name, np.sort(rng.uniform(0.0, 1.0, n))) for name in ("one", "other"))
    partners = pair_frames(one, other).partners
    used = partners[partners != NO_PARTNER]
    assert len(set(used.tolist())) == len(used)
    assert pair_frames(one, one).partners.tolist() == list(range(n))


def test_a_faster_stream_is_paired_with_every_frame_of_a_slower_one_and_the_rates_are_named():
    fast = make_stream("fast", np.arange(61) / 60.0)
    slow = make_stream("slow", np.arange(21) / 20.0 + 0.004)
    pairs = pair_frames(slow, fast)
    assert pairs.partners.tolist() == list(range(0, 61, 3))
    assert "slow has 20 Hz and fast 60 Hz" in pairs.note
    assert "40 of fast" in pairs.note


def test_streams_without_common_times_are_not_paired():
    pairs = pair_frames(
        make_stream("a", np.arange(5) / 10), make_stream("b", 1e6 + np.arange(5) / 10)
    )
    assert (pairs.partners == NO_PARTNER).all()
    assert isinstance(pairs.note, StageWarning)


@pytest.mark.parametrize("times_s", [None, [0.0, 0.0, 0.0], [np.nan] * 3])
def test_streams_without_times_are_paired_by_number(times_s):
    pairs = pair_frames(make_stream("a", times_s, 3), make_stream("b", np.arange(5) / 10))
    assert pairs.partners.tolist() == [0, 1, 2]
    assert "the first 3 are paired" in pairs.note


def test_a_partner_has_the_numbers_of_the_stream_that_it_follows():
    view = follow(make_stream("a", [0.0, 0.1, 0.2, 0.3]), make_stream("b", [0.0, 0.2, 0.3]))
    assert [view.frame(k).origin for k in (0, 2, 3)] == ["b 0", "b 1", "b 2"]
    assert (view.frame(2).index, view.truth(3).force_n[2]) == (2, 2.0)
    with pytest.raises(SettingProblem, match="frame 1 of 'a' has no partner"):
        view.frame(1)
