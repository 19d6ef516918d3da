"""Progress of long stages, and their cancellation."""

from collections.abc import Generator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Protocol


class Cancelled(Exception):
    """Raised by `Progress.step` when the result is no longer needed."""


class Progress(Protocol):
    """Receiver of a stage's progress."""

    def step(self, fraction: float, text: str) -> None:
        """Report `fraction` in 0..1 and the current activity.

        Raises `Cancelled` to stop the work.
        """
        ...


class SilentProgress:
    """A progress that is not shown and never cancelled."""

    def step(self, fraction: float, text: str) -> None:
        """Do nothing."""


SILENT = SilentProgress()
_reading: ContextVar[Progress] = ContextVar("reading", default=SILENT)


@contextmanager
def reading_reported_to(progress: Progress) -> Generator[None]:
    """Send `report_reading` within the block, on this thread, to `progress`."""
    token = _reading.set(progress)
    try:
        yield
    finally:
        _reading.reset(token)


def report_reading(fraction: float, text: str) -> None:
    """Report how much of a large file is read; raises `Cancelled` to stop."""
    _reading.get().step(fraction, text)


class SubProgress:
    """Part of a longer progress: begins at `start`, is `part` of the whole, has its own title."""

    def __init__(self, whole: Progress, start: float, part: float, title: str = "") -> None:
        self._whole = whole
        self._start = start
        self._part = part
        self._title = title

    def step(self, fraction: float, text: str) -> None:
        """Report as a fraction of the whole."""
        label = ": ".join(word for word in (self._title, text) if word)
        self._whole.step(self._start + self._part * min(max(fraction, 0.0), 1.0), label)
