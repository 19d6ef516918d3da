"""Background jobs: one thread and one waiting place per `LatestJob`.

A newer job replaces a waiting one.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from PyQt6 import sip
from PyQt6.QtCore import QObject, pyqtSignal

from pipeline.core import compiling
from pipeline.core.progress import Cancelled

_REPORT_INTERVAL_S = 0.05  # between progress signals; more often costs time and shows nothing


class JobReporter:
    """Given to a running job: reports progress, delivers parts, and raises `Cancelled` once the
    job is cancelled.
    """

    def __init__(self, job: LatestJob, ticket: int, work: JobFunction) -> None:
        self.job = job
        self.ticket = ticket
        self.work = work
        self.cancelled = threading.Event()
        self._reported_s = self._fraction = 0.0

    def step(self, fraction: float, text: str) -> None:
        """Report `fraction` in 0..1; raises `Cancelled`."""
        if self.cancelled.is_set():
            raise Cancelled
        now_s = time.monotonic()
        if now_s - self._reported_s >= _REPORT_INTERVAL_S:
            self._reported_s = now_s
            self._fraction = fraction
            self.job.progressed.emit(self.ticket, fraction, text)

    def report_message(self, text: str) -> None:
        """Report a message at the last fraction.

        Never raises, as the caller may be inside the compiler.
        """
        self.job.progressed.emit(self.ticket, self._fraction, text)

    def deliver(self, part: object) -> None:
        """Deliver a part of the result early; raises `Cancelled`."""
        if self.cancelled.is_set():
            raise Cancelled
        self.job.delivered.emit(self.ticket, part)


JobFunction = Callable[[JobReporter], object]


class LatestJob(QObject):
    """Runs the newest submitted job on its own thread.

    Every signal carries the ticket that `submit` returned.
    """

    started = pyqtSignal(int)
    progressed = pyqtSignal(int, float, str)
    delivered = pyqtSignal(int, object)
    finished = pyqtSignal(int, object)
    failed = pyqtSignal(int, object)
    cancelled = pyqtSignal(int)
    _ended = pyqtSignal()  # after finished, failed or cancelled

    def __init__(self, name: str, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._changed = threading.Condition()
        self._waiting: JobReporter | None = None
        self._running: JobReporter | None = None
        self._closing = False
        self.newest_ticket = 0
        self._n_unreported = 0  # started jobs whose end has not reached the listeners yet
        self._ended.connect(self._count_end)
        self._thread = threading.Thread(target=self._loop, name=name, daemon=True)
        self._thread.start()

    def submit(self, work: JobFunction, *, interrupt: bool = True) -> int:
        """Queue `work` in place of a waiting job, and return its ticket.

        `interrupt` also cancels the running job; without it that one finishes, so that a drag shows
        intermediate results.
        """
        with self._changed:
            if self._closing:
                return self.newest_ticket
            self.newest_ticket += 1
            dropped = self._waiting
            self._waiting = submitted = JobReporter(self, self.newest_ticket, work)
            if interrupt and self._running is not None:
                self._running.cancelled.set()
            self._changed.notify()
        if dropped is not None:
            self.cancelled.emit(dropped.ticket)
        return submitted.ticket

    def cancel(self) -> None:
        """Cancel the running job at its next step, and drop the waiting one."""
        with self._changed:
            dropped = self._waiting
            self._waiting = None
            if self._running is not None:
                self._running.cancelled.set()
        if dropped is not None:
            self.cancelled.emit(dropped.ticket)

    def skip_to_waiting(self) -> None:
        """Cancel the running job if another one waits."""
        with self._changed:
            if self._waiting is not None and self._running is not None:
                self._running.cancelled.set()

    @property
    def is_busy(self) -> bool:
        """Whether a job runs or waits."""
        with self._changed:
            return self._running is not None or self._waiting is not None

    @property
    def is_settled(self) -> bool:
        """Whether no job runs or waits, and listeners have received the end of the last one."""
        return not self.is_busy and not self._n_unreported

    def close(self, timeout_s: float = 5.0) -> bool:
        """Cancel and end the thread; returns whether it ended in time."""
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
                if self._closing or self._waiting is None:
                    return
                self._running = report = self._waiting
                self._waiting = None
                self._n_unreported += 1
            try:
                self._run(report)
                self._ended.emit()
            except RuntimeError:  # PyQt: the window is destroyed before the job could be cancelled
                if sip.isdeleted(self):
                    return
                raise

    def _run(self, report: JobReporter) -> None:
        self.started.emit(report.ticket)
        result = problem = None
        try:
            with compiling.report_compiling(report.report_message):
                result = report.work(report)
        except Cancelled:
            report.cancelled.set()
        except Exception as error:  # noqa: BLE001 - thread border: every error must reach the window
            problem = error
        with self._changed:
            self._running = None
        if problem is not None:
            self.failed.emit(report.ticket, problem)
        elif report.cancelled.is_set():
            self.cancelled.emit(report.ticket)
        else:
            self.finished.emit(report.ticket, result)

    def _count_end(self) -> None:
        with self._changed:
            self._n_unreported -= 1
