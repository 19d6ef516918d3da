"""Pair the frames of two streams: the nearest in time, or equal numbers where a stream has no
times.

Two frames are one moment if they lie within half an interval of the faster stream, and each is the
other's nearest. A frame that one stream lost, or that only the faster one recorded, has no partner.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pipeline.core.arrays import Doubles, Indices, freeze
from pipeline.core.errors import SettingProblem, StageWarning
from pipeline.core.frozen import frozen
from pipeline.core.values.frames import Stream, TactileFrame, Truth

NO_PARTNER = -1
_ROUNDING = 1e-6  # of an interval: times are stored in float32 or rounded to milliseconds
_SAME_RATE = 0.1  # relative difference of two rates that count as one
_MIN_FRAMES = 5  # of a stream whose rate is compared


@frozen
class FramePairs:
    """The frames of two streams that are one moment."""

    partners: Indices  # (frames of the first stream,) frame of the second; NO_PARTNER = none
    note: str = ""  # what is left out and why; "" = every frame of both has a partner

    @property
    def indices(self) -> Indices:
        """Frames of the first stream that have a partner."""
        return np.flatnonzero(self.partners != NO_PARTNER).astype(np.int32)


def pair_frames(one: Stream, other: Stream) -> FramePairs:
    """Pair the frames of two streams of one recording; a stream with itself frame by frame."""
    times = _get_times(one)
    other_times = _get_times(other)
    if times is None or other_times is None:
        n = min(one.n_frames, other.n_frames)
        partners = np.arange(one.n_frames, dtype=np.int32)
        partners[n:] = NO_PARTNER
        counts = f"{one.name} has {one.n_frames} frames, {other.name} {other.n_frames}"
        note = "" if one.n_frames == other.n_frames else f"{counts}: the first {n} are paired"
        return FramePairs(partners=freeze(partners), note=note)
    partners = _pair_times(times, other_times)
    return FramePairs(
        partners=partners, note=_describe_pairs(one, other, partners, times, other_times)
    )


def follow(one: Stream, other: Stream) -> Stream:
    """The second stream by the frame numbers of the first: frame `i` is the partner of the
    first's frame `i`.
    """
    partners = pair_frames(one, other).partners
    times = other.times_s

    def find(index: int) -> int:
        partner = int(partners[index]) if 0 <= index < len(partners) else NO_PARTNER
        if partner == NO_PARTNER:
            raise SettingProblem(
                f"frame {index} of {one.name!r} has no partner: {other.name!r} recorded no frame "
                "at its time"
            )
        return partner

    def frame(index: int) -> TactileFrame:
        return replace(other.frame(find(index)), index=index)

    def truth(index: int) -> Truth | None:
        return other.truth(find(index))

    times = (
        None if times is None else freeze(np.where(partners == NO_PARTNER, np.nan, times[partners]))
    )
    return replace(other, n_frames=one.n_frames, frame=frame, truth=truth, times_s=times)


def compute_interval_s(times_s: Doubles) -> float:
    """The usual interval, which a lost frame does not change.

    NaN for fewer than two different times.
    """
    steps = np.diff(np.sort(times_s[np.isfinite(times_s)]))
    steps = steps[steps > 0.0]
    return float(np.median(steps)) if steps.size else np.nan


def find_nearest(times_s: Doubles, wanted_s: Doubles) -> tuple[NDArray[np.intp], Doubles]:
    """(number of the nearest of rising times for each wanted one, the gap between them)."""
    after = np.clip(np.searchsorted(times_s, wanted_s), 1, max(len(times_s) - 1, 1))
    around = np.stack([after - 1, np.minimum(after, len(times_s) - 1)])
    gaps_s = np.abs(times_s[around] - wanted_s)
    nearest = np.take_along_axis(around, gaps_s.argmin(axis=0)[None], axis=0)[0]
    return nearest, gaps_s.min(axis=0)


def _get_times(stream: Stream) -> Doubles | None:
    """The times; None where all are equal or unknown and so tell no moment from another."""
    times = stream.times_s
    if (
        times is None
        or not np.isfinite(times).any()
        or (len(times) > 1 and np.isnan(compute_interval_s(times)))
    ):
        return None
    return times


def _pair_times(times: Doubles, other: Doubles) -> Indices:
    partners = np.full(len(times), NO_PARTNER, np.int32)
    known = np.flatnonzero(np.isfinite(times))
    known_other = np.flatnonzero(np.isfinite(other))
    order = known_other[np.argsort(other[known_other], kind="stable")]
    place, gap = find_nearest(other[order], times[known])
    nearest = order[place]
    intervals = [interval for t in (times, other) if np.isfinite(interval := compute_interval_s(t))]
    reach = 0.5 * min(intervals, default=np.inf) * (1.0 + _ROUNDING)
    closest_first = np.argsort(gap, kind="stable")
    closest_first = closest_first[gap[closest_first] <= reach]
    _, first = np.unique(nearest[closest_first], return_index=True)
    paired = closest_first[first]
    partners[known[paired]] = nearest[paired]
    return freeze(partners)


def _describe_pairs(
    one: Stream, other: Stream, partners: Indices, times: Doubles, other_times: Doubles
) -> str:
    n = int((partners != NO_PARTNER).sum())
    if n == one.n_frames == other.n_frames:
        return ""
    if not n:
        spans = " and ".join(
            f"{np.nanmin(t):.6g} to {np.nanmax(t):.6g} s" for t in (times, other_times)
        )
        return StageWarning(
            f"{one.name} and {other.name} share no moment (times of {spans}), so no frame is "
            "paired; check their clocks"
        )
    rates_hz = [1.0 / compute_interval_s(t) for t in (times, other_times)]
    differs = (
        min(one.n_frames, other.n_frames) >= _MIN_FRAMES
        and abs(np.log(rates_hz[0] / rates_hz[1])) > _SAME_RATE
    )
    rates = (
        f"{one.name} has {rates_hz[0]:.3g} Hz and {other.name} {rates_hz[1]:.3g} Hz: "
        if differs
        else ""
    )
    alone = ", ".join(
        f"{stream.n_frames - n} of {stream.name}" for stream in (one, other) if stream.n_frames > n
    )
    return (
        f"{rates}{n} frames of {one.name} and {other.name} are paired by their times; {alone} "
        "have no partner"
    )
