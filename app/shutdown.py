"""How the process ends: whatever ends it, windows go while Python and Qt are whole, and no edit is lost.

PyQt destroys what is left of windows at the very end, walking through its table of all objects that Python knows. A
window that goes then calls event filters and paintings written in Python, those make new objects, the table is laid
anew under the walk, and the process ends with a crash. So none may be left by then.
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
from PyQt6.QtWidgets import QApplication

if TYPE_CHECKING:
    from app.window.session_controller import SessionController

_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_BY_A_SIGNAL = 128  # what is added to a signal's number to make the code of a process that it ended


def destroy_windows_at_exit() -> None:
    """Have every window that is left at the end of Python destroyed before PyQt's own end; call it after PyQt is there.

    What is registered last is called first.
    """
    atexit.unregister(_destroy_windows)
    atexit.register(_destroy_windows)


def _destroy_windows() -> None:
    if QApplication.instance() is None:
        return
    for widget in QApplication.topLevelWidgets():
        if not sip.isdeleted(widget):  # one may have taken another along
            sip.delete(widget)


class ShutdownHandler(QObject):
    """Closes the window where Ctrl-C, a polite kill or a terminal that goes asks the process to end.

    Nobody can be asked then: what no file holds is kept and offered by the next window. A second signal is not caught.
    """

    def __init__(self, controller: SessionController) -> None:
        super().__init__(controller)
        self._controller = controller
        self.code = 0  # of the process, once a signal ends it
        # Qt waits outside Python, which runs a handler only once it is called: a byte in a socket has Qt call it.
        self._heard, self._told = socket.socketpair()
        for end in (self._heard, self._told):
            end.setblocking(False)
        self._wake = QSocketNotifier(sip.voidptr(self._heard.fileno()), QSocketNotifier.Type.Read, self)
        self._wake.activated.connect(self._called)
        self._fd = signal.set_wakeup_fd(self._told.fileno(), warn_on_full_buffer=False)
        before = {kind: signal.getsignal(kind) for kind in _SIGNALS}
        self._before = {kind: handler for kind, handler in before.items() if handler is not signal.SIG_IGN}
        for kind in self._before:
            signal.signal(kind, self._hear)

    def restore_signal_handlers(self) -> None:
        """Signals do again what they did before."""
        if self._before:
            self._wake.setEnabled(False)
            for kind, handler in self._before.items():
                signal.signal(kind, handler)
            signal.set_wakeup_fd(self._fd)
            self._before = {}
            self._heard.close()
            self._told.close()

    def _hear(self, kind: int, _where: FrameType | None) -> None:
        self.code = _BY_A_SIGNAL + kind

    def _called(self) -> None:
        with contextlib.suppress(BlockingIOError):
            self._heard.recv(64)
        if not self.code:
            return
        self.restore_signal_handlers()
        window = self._controller.window
        self._controller.termination_requested.emit()
        window.may_close = lambda: True
        window.close()
        QApplication.exit(self.code)  # of every loop: a dialog may wait for an answer
