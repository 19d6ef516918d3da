"""Ctrl-C and SIGTERM as a flag that the work checks at its next step.

An exception raised at an arbitrary point could be swallowed while a kernel compiles, or leave a file half written.
"""

import signal
import threading
from collections.abc import Callable, Generator
from contextlib import contextmanager


class InterruptibleProgress:
    """Progress without display that raises KeyboardInterrupt at the next step after a stop request."""

    def __init__(self) -> None:
        self._stop_requested = False

    def request_stop(self, *_signal: object) -> None:
        """Stop the work at its next step."""
        self._stop_requested = True

    def step(self, fraction: float, text: str) -> None:  # noqa: ARG002 - nothing is displayed
        """Raise KeyboardInterrupt after a stop request."""
        if self._stop_requested:
            raise KeyboardInterrupt


@contextmanager
def interruptible_progress() -> Generator[InterruptibleProgress, None, None]:
    """Progress that Ctrl-C and SIGTERM stop while the context lasts."""
    progress = InterruptibleProgress()
    with handle_interrupts(progress.request_stop):
        yield progress


@contextmanager
def handle_interrupts(handler: Callable[..., None]) -> Generator[None, None, None]:
    """Call `handler` on Ctrl-C and SIGTERM while the context lasts; no effect outside the main thread."""
    is_main = threading.current_thread() is threading.main_thread()
    previous = {kind: signal.signal(kind, handler) for kind in (signal.SIGINT, signal.SIGTERM) if is_main}
    try:
        yield
    finally:
        for kind, old_handler in previous.items():
            signal.signal(kind, old_handler)
