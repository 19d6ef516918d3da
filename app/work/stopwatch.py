"""How long our own code keeps the window's thread busy: every slot that shows something is timed."""

from __future__ import annotations

import time
from collections import defaultdict, deque
from collections.abc import Generator
from contextlib import contextmanager

LIMIT_MS = 16.0  # one picture of a 60 Hz screen
_KEPT = 500


class Stopwatch:
    """The latest durations by name, waits for the interpreter's lock and for a busy processor included."""

    def __init__(self) -> None:
        self.taken_ms: defaultdict[str, deque[float]] = defaultdict(lambda: deque(maxlen=_KEPT))

    @contextmanager
    def timed(self, name: str) -> Generator[None]:
        """Time what is inside."""
        started = time.perf_counter()
        try:
            yield
        finally:
            self.taken_ms[name].append(1e3 * (time.perf_counter() - started))
