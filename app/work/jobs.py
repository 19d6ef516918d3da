"""Background work: one thread, one place to wait, the newest request wins."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from PyQt6 import sip
from PyQt6.QtCore import QObject, pyqtSignal

from pipeline.base import compiling
from pipeline.base.progress import Cancelled

_REPORT_EVERY_S = 0.05  # a status bar that is written more often only costs time


class JobReporter:
    """What running work is given: tells how far it is and what is done, and stops once nobody wants it."""

    def __init__(self, job: LatestJob, ticket: int) -> None:
        self.job, self.ticket, self.cancelled = job, ticket, threading.Event()
        self._told_s = self._fraction = 0.0

    def step(self, fraction: float, text: str) -> None:
        """Report `fraction` in 0..1; raises `Cancelled` to stop the work."""
        if self.cancelled.is_set():
            raise Cancelled
        now_s = time.monotonic()
        if now_s - self._told_s >= _REPORT_EVERY_S:
            self._told_s, self._fraction = now_s, fraction
            self.job.progressed.emit(self.ticket, fraction, text)

    def report_message(self, text: str) -> None:
        """Say what is going on, however far it is; never stops the work, which may be in the midst of the compiler."""
        self.job.progressed.emit(self.ticket, self._fraction, text)

    def deliver(self, part: object) -> None:
        """Deliver a part of the result ahead of the rest; raises `Cancelled` like `step`."""
        if self.cancelled.is_set():
            raise Cancelled
        self.job.delivered.emit(self.ticket, part)


JobFunction = Callable[[JobReporter], object]


class LatestJob(QObject):
    """Runs only the newest request; every signal carries the ticket that `submit` returned."""

    started = pyqtSignal(int)
    progressed = pyqtSignal(int, float, str)
    delivered = pyqtSignal(int, object)
    finished = pyqtSignal(int, object)
    failed = pyqtSignal(int, object)
    cancelled = pyqtSignal(int)
    _over = pyqtSignal()  # behind whichever of the three above

    def __init__(self, name: str, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._changed = threading.Condition()
        self._waiting: JobReporter | None = None
        self._work: JobFunction | None = None
        self._running: JobReporter | None = None
        self._closing = False
        self.newest_ticket = 0
        self._untold = 0  # how much work was begun whose end was not told yet
        self._over.connect(self._told)
        self._thread = threading.Thread(target=self._loop, name=name, daemon=True)
        self._thread.start()

    def submit(self, work: JobFunction, *, interrupt: bool = True) -> int:
        """Queue `work` in place of whatever waits, and return its ticket.

        `interrupt` also stops what runs; without it that may finish, so that a drag shows something on its way.
        """
        with self._changed:
            if self._closing:
                return self.newest_ticket
            self.newest_ticket += 1
            dropped, self._waiting, self._work = self._waiting, JobReporter(self, self.newest_ticket), work
            if interrupt and self._running is not None:
                self._running.cancelled.set()
            self._changed.notify()
            ticket = self.newest_ticket
        if dropped is not None:
            self.cancelled.emit(dropped.ticket)
        return ticket

    def cancel(self) -> None:
        """Stop what runs at its next step, and forget what waits."""
        with self._changed:
            dropped, self._waiting, self._work = self._waiting, None, None
            if self._running is not None:
                self._running.cancelled.set()
        if dropped is not None:
            self.cancelled.emit(dropped.ticket)

    @property
    def is_busy(self) -> bool:
        """Whether anything runs or waits."""
        with self._changed:
            return self._running is not None or self._waiting is not None

    @property
    def is_settled(self) -> bool:
        """Whether nothing runs or waits, and whoever listens has heard how the last of it ended."""
        return not self.is_busy and not self._untold

    def close(self, timeout_s: float = 5.0) -> bool:
        """Stop for good; whether the thread ended in time."""
        self.cancel()
        with self._changed:
            self._closing = True
            self._changed.notify()
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _loop(self) -> None:
        while True:
            with self._changed:
                while self._waiting is None and not self._closing:
                    self._changed.wait()
                if self._closing or self._waiting is None or self._work is None:
                    return
                report, work = self._waiting, self._work
                self._running, self._waiting, self._work = report, None, None
                self._untold += 1
            try:
                self._run(report, work)
                self._over.emit()
            except RuntimeError:  # of PyQt: the window is gone, and this work could not be stopped in time
                if sip.isdeleted(self):
                    return
                raise

    def _run(self, report: JobReporter, work: JobFunction) -> None:
        self.started.emit(report.ticket)
        try:
            with compiling.report_compiling(report.report_message):
                result = work(report)
        except Cancelled:
            self._free()
            self.cancelled.emit(report.ticket)
        except Exception as error:  # noqa: BLE001 - the border: RuntimeErrors too must reach the window
            self._free()
            self.failed.emit(report.ticket, error)
        else:
            self._free()
            stopped = report.cancelled.is_set()
            _ = self.cancelled.emit(report.ticket) if stopped else self.finished.emit(report.ticket, result)

    def _told(self) -> None:
        with self._changed:
            self._untold -= 1

    def _free(self) -> None:
        with self._changed:
            self._running = None
