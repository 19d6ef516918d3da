"""How long our own code keeps the window's thread busy: every slot that shows something is timed."""

from __future__ import annotations

import statistics
import time
from collections import defaultdict, deque
from collections.abc import Generator, Mapping
from contextlib import contextmanager

LIMIT_MS = 16.0  # one picture of a 60 Hz screen
_KEPT = 500


class Stopwatch:
    """The latest durations by name."""

    def __init__(self) -> None:
        self._ms: defaultdict[str, deque[float]] = defaultdict(lambda: deque(maxlen=_KEPT))

    @contextmanager
    def timed(self, name: str) -> Generator[None]:
        """Time what is inside."""
        started = time.perf_counter()
        try:
            yield
        finally:
            self._ms[name].append(1e3 * (time.perf_counter() - started))

    @property
    def longest_ms(self) -> Mapping[str, float]:
        """The worst by name, waits for the interpreter's lock and for a busy processor included."""
        return {name: max(kept) for name, kept in self._ms.items()}

    @property
    def median_ms(self) -> Mapping[str, float]:
        """The middle by name, which a busy machine disturbs little."""
        return {name: statistics.median(kept) for name, kept in self._ms.items()}

    def forget(self) -> None:
        """Start over."""
        self._ms.clear()
