"""How long our own code keeps the window's thread busy: every slot that shows something is timed."""

from __future__ import annotations

import time
from collections.abc import Generator
from contextlib import contextmanager

LIMIT_MS = 16.0  # one picture of a 60 Hz screen


class Stopwatch:
    """Longest and latest durations by name."""

    def __init__(self) -> None:
        self.longest_ms: dict[str, float] = {}

    @contextmanager
    def timed(self, name: str) -> Generator[None]:
        """Time what is inside."""
        started = time.perf_counter()
        try:
            yield
        finally:
            ms = 1e3 * (time.perf_counter() - started)
            self.longest_ms[name] = max(ms, self.longest_ms.get(name, 0.0))

    def forget(self) -> None:
        """Start over."""
        self.longest_ms.clear()
