"""Log records as Qt signals, and uncaught errors in log and banner."""

import logging
import sys
import threading
from types import TracebackType

from PyQt6.QtCore import QObject, pyqtSignal

from app.window.dialogs import format_unit_problem
from pipeline.core import user_folders
from pipeline.core.errors import TouchError, name_options
from pipeline.core.geometry.meshes import UnitProblem

log = logging.getLogger("tactoscope")


class LogRelay(QObject):
    """Passes log lines and uncaught errors of any thread to the window's thread."""

    line_logged = pyqtSignal(int, str)
    error_uncaught = pyqtSignal(object)

    def __init__(self, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._handler = _Handler(self)
        log.addHandler(self._handler)
        log.setLevel(logging.DEBUG)

    def catch_uncaught(self) -> None:
        """Report uncaught errors; PyQt would abort the process for one in a callback."""
        sys.excepthook = self._report_error
        threading.excepthook = self._report_thread_error

    def close(self) -> None:
        """Remove the log handler and the hooks."""
        log.removeHandler(self._handler)
        if sys.excepthook == self._report_error:
            sys.excepthook = sys.__excepthook__
            threading.excepthook = threading.__excepthook__

    def _report_error(
        self, kind: type[BaseException], error: BaseException, trace: TracebackType | None
    ) -> None:
        if issubclass(kind, KeyboardInterrupt):
            sys.__excepthook__(kind, error, trace)
            return
        log.error("uncaught error", exc_info=(kind, error, trace))
        if not isinstance(error, TouchError):  # one that a user can mend is in the banner
            sys.__excepthook__(kind, error, trace)
        self.error_uncaught.emit(error)

    def _report_thread_error(self, args: threading.ExceptHookArgs) -> None:
        if args.exc_value is not None:
            self._report_error(args.exc_type, args.exc_value, args.exc_traceback)


class _Handler(logging.Handler):
    def __init__(self, relay: LogRelay) -> None:
        super().__init__()
        self._relay = relay
        self.setFormatter(
            logging.Formatter("%(asctime)s  %(levelname)-7s  %(message)s", "%H:%M:%S")
        )

    def emit(self, record: logging.LogRecord) -> None:
        self._relay.line_logged.emit(record.levelno, self.format(record))


def describe_error(error: BaseException) -> tuple[str, str]:
    """Return (sentence, details) for the banner.

    Details hold the traceback of unexpected errors.
    """
    if isinstance(error, TouchError):
        text = format_unit_problem(error) if isinstance(error, UnitProblem) else str(error)
        return name_options(text), ""
    return user_folders.format_sentence(error), user_folders.format_details(error)
