"""Time budget of a frame: what every stage takes when it is computed, and which to skip to reach a frame rate."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from statistics import median

from pipeline.engine.graph import Method, StageResult

_N_RECENT = 20  # computed frames that a median is of
_MS_PER_S = 1e3


@dataclass(frozen=True, slots=True, kw_only=True)
class TimeBudget:
    """Median time of every stage of a frame, in the order in which they run."""

    times_ms: Mapping[str, float]  # stage -> median of its recent times
    reads: Mapping[str, tuple[str, ...]]  # stage -> stages and inputs that it reads

    @property
    def total_ms(self) -> float:
        """Time of a frame in which every stage is computed."""
        return sum(self.times_ms.values())

    @property
    def rate_hz(self) -> float:
        """Frames a second, if every stage of every frame is computed; infinite without a time."""
        return _MS_PER_S / self.total_ms if self.total_ms > 0 else float("inf")

    def get_share(self, stage: str) -> float:
        """Share of a stage in a frame's time; 0 where it has no time."""
        return self.times_ms.get(stage, 0.0) / self.total_ms if self.total_ms > 0 else 0.0

    def find_dependents(self, stage: str) -> frozenset[str]:
        """Return a stage and all that cannot be computed without it."""
        found = {stage}
        for name, reads in self.reads.items():
            if found.intersection(reads):
                found.add(name)
        return frozenset(found)

    def without(self, stages: frozenset[str]) -> TimeBudget:
        """Return the budget of a frame in which these stages are skipped."""
        return TimeBudget(times_ms={n: ms for n, ms in self.times_ms.items() if n not in stages}, reads=self.reads)

    def find_skip(self, rate_hz: float) -> frozenset[str] | None:
        """Return the fewest stages whose skip reaches a frame rate, the slowest of as many; None if no skip does.

        A stage is skipped with all that depend on it, and one stage remains. The empty set says that none need be.
        """
        if self.rate_hz >= rate_hz:
            return frozenset()
        alone = [self.find_dependents(stage).intersection(self.times_ms) for stage in self.times_ms]
        offers = {frozenset[str]().union(*chosen) for n in range(1, len(alone)) for chosen in combinations(alone, n)}
        enough = [
            skip for skip in offers if len(skip) < len(self.times_ms) and self.without(skip).rate_hz >= rate_hz
        ]  # fmt: skip
        return min(enough, key=lambda skip: (len(skip), self.without(skip).total_ms), default=None)


class StageClock:
    """Recent times of every method with its present parameters; results from the cache do not count."""

    def __init__(self) -> None:
        self._recent: dict[str, tuple[object, deque[float]]] = {}

    def record(self, result: StageResult, params: object) -> None:
        """Add the time of a result, if it was computed in full with `params`."""
        if result.method is None or result.state != "computed" or result.draft:
            return
        known = self._recent.get(result.method.key)
        if known is None or known[0] != params:
            known = params, deque[float](maxlen=_N_RECENT)
            self._recent[result.method.key] = known
        known[1].append(result.ms)

    def compute_budget(self, methods: Sequence[Method]) -> TimeBudget:
        """Return the budget of a frame in which these methods are computed; those never timed are absent."""
        times = {m.stage: median(self._recent[m.key][1]) for m in methods if m.key in self._recent}
        return TimeBudget(times_ms=times, reads={m.stage: m.reads for m in methods})
