"""Ctrl-C, or being told to end (SIGTERM), as a question that is answered at the next step of the work.

An interruption that is raised anywhere may fall into the compiling of a loop, which swallows it, or between two files.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Generator
from contextlib import contextmanager


class InterruptibleProgress:
    """A progress that nobody watches, and that ends the work with KeyboardInterrupt once asked to."""

    def __init__(self) -> None:
        self._asked = False

    def request_stop(self, *_signal: object) -> None:
        """Ask the work to stop."""
        self._asked = True

    def step(self, fraction: float, text: str) -> None:  # noqa: ARG002 - nobody watches
        """Go on, or raise KeyboardInterrupt."""
        if self._asked:
            raise KeyboardInterrupt


@contextmanager
def interruptible_progress() -> Generator[InterruptibleProgress, None, None]:
    """While it lasts Ctrl-C and SIGTERM ask."""
    work = InterruptibleProgress()
    with handle_interrupts(work.request_stop):
        yield work


@contextmanager
def handle_interrupts(ask: Callable[..., None]) -> Generator[None, None, None]:
    """While it lasts Ctrl-C and SIGTERM call `ask`; a thread other than the main one hears no signals."""
    heard = threading.current_thread() is threading.main_thread()
    before = {kind: signal.signal(kind, ask) for kind in (signal.SIGINT, signal.SIGTERM) if heard}
    try:
        yield
    finally:
        for kind, handler in before.items():
            signal.signal(kind, handler)
