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


class Silent:
    """A progress that nobody watches and nobody cancels."""

    def step(self, fraction: float, text: str) -> None:
        """Do nothing."""


SILENT = Silent()
