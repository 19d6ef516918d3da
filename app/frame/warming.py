"""An empty window makes itself ready for a first recording while nobody has chosen one."""

from __future__ import annotations

from PyQt6.QtCore import QObject

from app.frame.instrument import Instrument
from app.session.state import Session
from app.work.jobs import LatestJob
from app.work.warming import read_a_touch
from widgets.looks import once

_AFTER_MS = 700  # the window, its 3D views among it, comes first


class Warming(QObject):
    """Works once, on a thread of its own; what is opened meanwhile loads the same, and goes first."""

    def __init__(self, instrument: Instrument) -> None:
        super().__init__(instrument)
        self.job = LatestJob("warming", self)
        self.soon = once(self, _AFTER_MS, lambda: self.job.submit(read_a_touch))
        instrument.session_shown.connect(self._stop)
        instrument.closing.connect(self._close)
        if instrument.session.recording is None:
            self.soon.start()

    def _stop(self, session: Session) -> None:
        if session.recording is not None:
            self.soon.stop()
            self.job.cancel()

    def _close(self) -> None:
        self.soon.stop()
        self.job.close()
