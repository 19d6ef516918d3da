"""Preloads what the first depth needs while no recording is open, and what sampling needs once a frame is shown."""

from app.session.state import Session
from app.window.feature import Feature
from app.window.session_controller import SessionController
from app.work.jobs import LatestJob
from app.work.preload import preload_depth, preload_samplers
from widgets.styling import make_single_shot_timer

_DELAY_MS = 700  # the window and its 3D views come first
_SAMPLER_DELAY_MS = 1500  # after a frame; browsing comes first


class PreloadController(Feature):
    """Loads packages and kernels on a thread of its own; stops when a recording opens, which loads the same."""

    def __init__(self, controller: SessionController) -> None:
        super().__init__(controller)
        self.job = LatestJob("preload", self)
        self.start_timer = make_single_shot_timer(self, _DELAY_MS, lambda: self.job.submit(preload_depth))
        self.sampler_timer = make_single_shot_timer(self, _SAMPLER_DELAY_MS, self._preload_samplers)
        controller.frame_shown.connect(self._preload_samplers_soon)
        controller.session_shown.connect(self._stop)
        controller.closing.connect(self.job.close)
        if controller.session.recording is None:
            self.start_timer.start()

    def _stop(self, session: Session) -> None:
        if session.recording is not None:
            self.start_timer.stop()
            self.job.cancel()

    def _preload_samplers_soon(self, _: int) -> None:
        self.sampler_timer.start()

    def _preload_samplers(self) -> None:
        opened = self._controller.views.translation
        if opened is not None and self._controller.is_idle and not self._window.timeline.is_playing:
            self.job.submit(lambda _: preload_samplers(opened.weights.values()))
