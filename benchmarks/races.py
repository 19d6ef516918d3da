"""Ours and a peer on the same inputs, in turns, in one process; and what must hold of them. Not a question itself."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.racing.races import Row

RUNS = 15
_WARM_UP = 2  # the first calls compile, load libraries and fill caches


@dataclass(frozen=True, slots=True, kw_only=True)
class Timing:
    """How long one method took, over runs that took turns with the others'."""

    median_ms: float
    p95_ms: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Bar:
    """What must hold for a claim to be made; what is None is not asked."""

    faster: float | None = None  # at least this many times the peer's speed
    ms: float | None = None  # at most this long
    closer: float | None = None  # the peer's error is at least this many times ours
    error: float | None = None  # at most this large, in the row's unit

    def told(self, unit: str) -> str:
        """The bar in words."""
        parts = (
            f"{self.faster:g}x faster" if self.faster is not None else "",
            f"at most {self.ms:g} ms" if self.ms is not None else "",
            f"{self.closer:g}x lower error" if self.closer is not None else "",
            f"error at most {self.error:g} {unit}".rstrip() if self.error is not None else "",
        )
        return ", ".join(part for part in parts if part)

    def limits(self, peer: tuple[float, float]) -> tuple[float, float]:
        """The most (ms, error) of ours that clear the bar against the peer's; NaN where nothing is asked."""
        return _least(self.ms, self.faster, peer[0]), _least(self.error, self.closer, peer[1])

    def holds(self, ours: tuple[float, float], peer: tuple[float, float]) -> bool:
        """Whether (ms, error) of ours clears the bar against (ms, error) of the peer; what is NaN clears nothing."""
        (ms, error), (peer_ms, peer_error) = ours, peer
        return all((
            self.faster is None or peer_ms >= self.faster * ms,
            self.ms is None or ms <= self.ms,
            self.closer is None or peer_error >= self.closer * error,
            self.error is None or error <= self.error,
        ))  # fmt: skip


def race(methods: Mapping[str, Callable[[], object]], runs: int = RUNS, calls: int = 1) -> dict[str, Timing]:
    """Timings of methods that take turns, forward and backward (A B B A), so that drift hits all alike.

    In its turn a method is called `calls` times and each call counts for the mean of them: with more than one, a short
    call is not mostly the cold caches that a long one of another method left. Compare the outputs before the times.
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
    return {name: timing(ms) for name, ms in taken.items()}


def timing(taken_ms: Sequence[float]) -> Timing:
    """Of times that were taken in another way than by `race`."""
    return Timing(median_ms=float(np.median(taken_ms)), p95_ms=float(np.percentile(taken_ms, 95)))


def row(
    question: str,
    *,
    ours: Timing,
    ours_error: float,
    unit: str,
    bar: Bar,
    peer: str = "",
    peer_timing: Timing | None = None,
    peer_error: float = math.nan,
) -> Row:
    """The row of one claim; without a peer only `Bar.ms` and `Bar.error` can hold."""
    other = peer_timing or Timing(median_ms=math.nan, p95_ms=math.nan)
    limit_ms, limit_error = bar.limits((other.median_ms, peer_error))
    return Row(
        question=question,
        peer=peer,
        ours_ms=ours.median_ms,
        peer_ms=other.median_ms,
        ratio=other.median_ms / ours.median_ms if ours.median_ms > 0 else math.nan,
        ours_error=ours_error,
        peer_error=peer_error,
        unit=unit,
        bar=bar.told(unit),
        holds=bar.holds((ours.median_ms, ours_error), (other.median_ms, peer_error)),
        ours_p95_ms=ours.p95_ms,
        peer_p95_ms=other.p95_ms,
        limit_ms=limit_ms,
        limit_error=limit_error,
    )


def _least(absolute: float | None, times: float | None, of_peer: float) -> float:
    limits = ([] if absolute is None else [absolute]) + ([] if times is None else [of_peer / times])
    return min((v for v in limits if math.isfinite(v)), default=math.nan)
