"""Log records as Qt signals, and uncaught errors as log records and banners."""

from __future__ import annotations

import logging
import sys
import threading
from types import TracebackType

from PyQt6.QtCore import QObject, pyqtSignal

from app.frame.dialogs import in_another_unit
from pipeline.base import unexpected
from pipeline.base.errors import TouchError
from pipeline.geometry.meshes import UnitProblem

log = logging.getLogger("tactoscope")


class LogRelay(QObject):
    """Passes log lines and uncaught errors of any thread on to the window's thread."""

    line = pyqtSignal(int, str)
    uncaught = pyqtSignal(object)

    def __init__(self, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._handler = _Handler(self)
        log.addHandler(self._handler)
        log.setLevel(logging.DEBUG)

    def catch_uncaught(self) -> None:
        """Show errors that nobody caught: PyQt would end the process for one in a slot."""
        sys.excepthook = self._uncaught
        threading.excepthook = self._uncaught_in_thread

    def close(self) -> None:
        """Let go of the log and of the hooks."""
        log.removeHandler(self._handler)
        if sys.excepthook == self._uncaught:
            sys.excepthook = sys.__excepthook__
            threading.excepthook = threading.__excepthook__

    def _uncaught(self, kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
        if issubclass(kind, KeyboardInterrupt):
            sys.__excepthook__(kind, error, trace)
            return
        log.error("uncaught error", exc_info=(kind, error, trace))
        self.uncaught.emit(error)

    def _uncaught_in_thread(self, args: threading.ExceptHookArgs) -> None:
        if args.exc_value is not None:
            self._uncaught(args.exc_type, args.exc_value, args.exc_traceback)


class _Handler(logging.Handler):
    def __init__(self, relay: LogRelay) -> None:
        super().__init__()
        self._relay = relay
        self.setFormatter(logging.Formatter("%(asctime)s  %(levelname)-7s  %(message)s", "%H:%M:%S"))

    def emit(self, record: logging.LogRecord) -> None:
        self._relay.line.emit(record.levelno, self.format(record))


def sentence_and_details(error: BaseException) -> tuple[str, str]:
    """What the banner says: a TouchError's own sentence, else a short one with the traceback as details."""
    if isinstance(error, TouchError):
        return in_another_unit(error) if isinstance(error, UnitProblem) else str(error), ""
    return unexpected.sentence(error), unexpected.details(error)
