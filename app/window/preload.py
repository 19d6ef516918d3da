"""Preloads packages and kernels while no recording is open."""

from __future__ import annotations

from PyQt6.QtCore import QObject

from app.session.state import Session
from app.window.session_controller import SessionController
from app.work.jobs import LatestJob
from app.work.preload import preload_depth
from widgets.styling import make_single_shot_timer

_DELAY_MS = 700  # the window and its 3D views come first


class PreloadController(QObject):
    """Loads packages and kernels once, on a thread of its own; stops when a recording opens, which loads the same."""

    def __init__(self, controller: SessionController) -> None:
        super().__init__(controller)
        self.job = LatestJob("preload", self)
        self.start_timer = make_single_shot_timer(self, _DELAY_MS, lambda: self.job.submit(preload_depth))
        controller.session_shown.connect(self._stop)
        controller.closing.connect(self._close)
        if controller.session.recording is None:
            self.start_timer.start()

    def _stop(self, session: Session) -> None:
        if session.recording is not None:
            self.start_timer.stop()
            self.job.cancel()

    def _close(self) -> None:
        self.start_timer.stop()
        self.job.close()
