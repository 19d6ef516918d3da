"""How a long stage reports where it is, and how it is cancelled."""

from __future__ import annotations

from typing import Protocol


class Cancelled(Exception):
    """Raised inside `Progress.step` once nobody wants the result any more."""


class Progress(Protocol):
    """Anything that can be told how far a stage has come."""

    def step(self, fraction: float, text: str) -> None:
        """Report `fraction` in 0..1 and what is being done; raises `Cancelled` to stop the work."""
        ...


class SilentProgress:
    """A progress that nobody watches and nobody cancels."""

    def step(self, fraction: float, text: str) -> None:
        """Do nothing."""


SILENT = SilentProgress()


class SubProgress:
    """The part of a longer progress that begins at `start` and is `part` of the whole, under a title of its own."""

    def __init__(self, whole: Progress, start: float, part: float, title: str = "") -> None:
        self._whole, self._start, self._part, self._title = whole, start, part, title

    def step(self, fraction: float, text: str) -> None:
        """Pass on as a fraction of the whole."""
        label = ": ".join(word for word in (self._title, text) if word)
        self._whole.step(self._start + self._part * min(max(fraction, 0.0), 1.0), label)
