"""Ctrl-C as a question that is answered at the next step of the work.

An interruption that is raised anywhere may fall into the compiling of a loop, which swallows it, or between two files.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Generator
from contextlib import contextmanager


class Stoppable:
    """A progress that nobody watches, and that ends the work with KeyboardInterrupt once asked to."""

    def __init__(self) -> None:
        self._asked = False

    def ask(self, *_signal: object) -> None:
        """Ask the work to stop."""
        self._asked = True

    def step(self, fraction: float, text: str) -> None:  # noqa: ARG002 - nobody watches
        """Go on, or raise KeyboardInterrupt."""
        if self._asked:
            raise KeyboardInterrupt


@contextmanager
def stoppable() -> Generator[Stoppable, None, None]:
    """While it lasts Ctrl-C asks; a thread other than the main one, which hears no signals, is never asked."""
    work = Stoppable()
    if threading.current_thread() is not threading.main_thread():
        yield work
        return
    before = signal.signal(signal.SIGINT, work.ask)
    try:
        yield work
    finally:
        signal.signal(signal.SIGINT, before)
