"""Time methods in turns on the same inputs in one process, and check requirements on the result."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.harness.results import Measurement

N_RUNS = 15
_WARM_UP = 2  # the first calls compile, load libraries and fill caches


@dataclass(frozen=True, slots=True, kw_only=True)
class Timing:
    """Run time of one method over repeated runs."""

    median_ms: float
    p95_ms: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Requirement:
    """What must hold for a claim to be made; None means no requirement."""

    min_speedup: float | None = None  # at least this many times the baseline's speed
    max_ms: float | None = None  # at most this long
    min_error_ratio: float | None = None  # the baseline's error is at least this many times ours
    max_error: float | None = None  # at most this large, in the row's unit

    def describe(self, unit: str) -> str:
        """The bar in words."""
        parts = (
            f"{self.min_speedup:g}x faster" if self.min_speedup is not None else "",
            f"at most {self.max_ms:g} ms" if self.max_ms is not None else "",
            f"{self.min_error_ratio:g}x lower error" if self.min_error_ratio is not None else "",
            f"error at most {self.max_error:g} {unit}".rstrip()
            if self.max_error is not None
            else "",
        )
        return ", ".join(part for part in parts if part)

    def compute_limits(self, peer: tuple[float, float]) -> tuple[float, float]:
        """The most (ms, error) of ours that clear the bar against the baseline's.

        NaN where there is no requirement.
        """
        return _least(self.max_ms, self.min_speedup, peer[0]), _least(
            self.max_error, self.min_error_ratio, peer[1]
        )

    def is_met(self, ours: tuple[float, float], peer: tuple[float, float]) -> bool:
        """Whether (ms, error) of ours meets the requirement against the baseline.

        NaN meets nothing.
        """
        (ms, error), (peer_ms, peer_error) = ours, peer
        return all(
            (
                self.min_speedup is None or peer_ms >= self.min_speedup * ms,
                self.max_ms is None or ms <= self.max_ms,
                self.min_error_ratio is None or peer_error >= self.min_error_ratio * error,
                self.max_error is None or error <= self.max_error,
            )
        )


def time_in_turns(
    methods: Mapping[str, Callable[[], object]], runs: int = N_RUNS, calls: int = 1
) -> dict[str, Timing]:
    """Timings of methods that take turns, forward and backward (A B B A), so that drift hits all
    alike.

    In its turn a method is called `calls` times and each call counts for the mean of them: with
    more than one, a short call is not mostly the cold caches that a long one of another method
    left. Compare the outputs before the times.
    """
    for call in methods.values():
        for _ in range(_WARM_UP):
            call()
    taken: dict[str, list[float]] = {name: [] for name in methods}
    for turn in range(runs):
        for name in tuple(methods)[:: 1 if turn % 2 == 0 else -1]:
            call = methods[name]
            started = time.perf_counter()
            for _ in range(calls):
                call()
            taken[name].append(1e3 * (time.perf_counter() - started) / calls)
    return {name: summarize_times(ms) for name, ms in taken.items()}


def summarize_times(taken_ms: Sequence[float]) -> Timing:
    """Summarise run times (ms) that were measured by other means."""
    return Timing(median_ms=float(np.median(taken_ms)), p95_ms=float(np.percentile(taken_ms, 95)))


def build_measurement(
    question: str,
    *,
    ours: Timing,
    ours_error: float,
    unit: str,
    bar: Requirement,
    peer: str = "",
    peer_timing: Timing | None = None,
    peer_error: float = math.nan,
) -> Measurement:
    """Build the row of one claim; without a baseline only `max_ms` and `max_error` can be met."""
    other = peer_timing or Timing(median_ms=math.nan, p95_ms=math.nan)
    limit_ms, limit_error = bar.compute_limits((other.median_ms, peer_error))
    return Measurement(
        question=question,
        peer=peer,
        ours_ms=ours.median_ms,
        peer_ms=other.median_ms,
        ratio=other.median_ms / ours.median_ms if ours.median_ms > 0 else math.nan,
        ours_error=ours_error,
        peer_error=peer_error,
        unit=unit,
        bar=bar.describe(unit),
        holds=bar.is_met((ours.median_ms, ours_error), (other.median_ms, peer_error)),
        ours_p95_ms=ours.p95_ms,
        peer_p95_ms=other.p95_ms,
        limit_ms=limit_ms,
        limit_error=limit_error,
    )


def _least(absolute: float | None, times: float | None, of_peer: float) -> float:
    limits = ([] if absolute is None else [absolute]) + ([] if times is None else [of_peer / times])
    return min((v for v in limits if math.isfinite(v)), default=math.nan)
