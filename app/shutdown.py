"""Orderly shutdown: windows are destroyed before PyQt's own cleanup, and signals save the session.

At exit PyQt destroys remaining windows while it iterates over its table of wrapped objects. Event
filters and paint events written in Python then create new objects, the table is resized during the
iteration, and the process crashes. Therefore no window may be left by then.
"""

from __future__ import annotations

import atexit
import contextlib
import signal
import socket
from types import FrameType
from typing import TYPE_CHECKING

from PyQt6 import sip
from PyQt6.QtCore import QObject, QSocketNotifier
from PyQt6.QtWidgets import QApplication, QMainWindow

if TYPE_CHECKING:
    from app.document.session_controller import SessionController

_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_SIGNAL_EXIT_CODE = 128  # shell convention: exit code 128 + signal number


def destroy_windows_at_exit() -> None:
    """Register the destruction of all windows at exit; call it after PyQt is imported.

    Functions registered last run first, so this one runs before PyQt's.
    """
    atexit.unregister(_destroy_windows)
    atexit.register(_destroy_windows)


def _destroy_windows() -> None:
    if QApplication.instance() is None:
        return
    # Plots share their menus with widgets of their own: what they are in is destroyed first, and
    # takes them with it.
    for widget in sorted(
        QApplication.topLevelWidgets(), key=lambda widget: not isinstance(widget, QMainWindow)
    ):
        if not sip.isdeleted(widget):  # destroyed with its parent
            sip.delete(widget)


class ShutdownHandler(QObject):
    """Closes the window on SIGINT, SIGTERM and SIGHUP, without questions.

    Unsaved changes go to the recovery file. A second signal is not caught.
    """

    def __init__(self, controller: SessionController) -> None:
        super().__init__(controller)
        self._controller = controller
        self.code = 0  # exit code of the process once a signal ends it
        # Python runs signal handlers only when it runs; a byte in a socket makes Qt call into
        # Python.
        self._receiver, self._sender = socket.socketpair()
        for end in (self._receiver, self._sender):
            end.setblocking(False)
        self._notifier = QSocketNotifier(
            sip.voidptr(self._receiver.fileno()), QSocketNotifier.Type.Read, self
        )
        self._notifier.activated.connect(self._shut_down)
        self._fd = signal.set_wakeup_fd(self._sender.fileno(), warn_on_full_buffer=False)
        handlers = {kind: signal.getsignal(kind) for kind in _SIGNALS}
        self._old_handlers = {
            kind: handler for kind, handler in handlers.items() if handler is not signal.SIG_IGN
        }
        for kind in self._old_handlers:
            signal.signal(kind, self._record_signal)

    def restore_signal_handlers(self) -> None:
        """Restore the signal handlers from before."""
        if self._old_handlers:
            self._notifier.setEnabled(False)
            for kind, handler in self._old_handlers.items():
                signal.signal(kind, handler)
            signal.set_wakeup_fd(self._fd)
            self._old_handlers = {}
            self._receiver.close()
            self._sender.close()

    def _record_signal(self, kind: int, _where: FrameType | None) -> None:
        self.code = _SIGNAL_EXIT_CODE + kind

    def _shut_down(self) -> None:
        with contextlib.suppress(BlockingIOError):
            self._receiver.recv(64)
        if not self.code:
            return
        self.restore_signal_handlers()
        window = self._controller.window
        self._controller.termination_requested.emit()
        window.may_close = lambda: True
        window.close()
        QApplication.exit(self.code)  # also leaves the event loop of an open dialog
