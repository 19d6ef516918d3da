"""The blame tab at work: a frame at rest has its error taken apart while somebody sees the tab."""

from __future__ import annotations

from PyQt6.QtCore import QEvent, QObject, QTimer

from app.window.session_controller import SessionController
from pipeline.metrics.stage_metrics import METRICS
from pipeline.translation.error_attribution import DEFAULT_METRIC, ErrorAttribution
from pipeline.translation.translate import Translation
from widgets.error_attribution_panel import make_bars

_AT_REST_MS = 250  # truth in five slots costs several times a frame: not while one is searched for or played
_NO_TRUTH = "no error is known of this frame: the recording does not hold what the target really felt"


class ErrorAttributionController(QObject):
    """Between the tab and the controller."""

    def __init__(self, controller: SessionController) -> None:
        super().__init__(controller)
        self._controller, self._panel = controller, controller.window.error_attribution
        self._figure, self._ticket = DEFAULT_METRIC, 0
        self._rest = QTimer(self)
        self._rest.setSingleShot(True)
        self._rest.setInterval(_AT_REST_MS)
        self._rest.timeout.connect(self._ask)
        self._panel.installEventFilter(self)
        self._panel.metric_chosen.connect(self._choose)
        controller.frame_shown.connect(self._frame_shown)
        controller.closing.connect(self._rest.stop)
        controller.job.delivered.connect(self._opened)
        controller.job.finished.connect(self._take)

    def eventFilter(self, a0: QObject | None, a1: QEvent | None) -> bool:  # noqa: N802
        """The tab comes to the front, or goes."""
        if a1 is not None and a1.type() == QEvent.Type.Show:
            self._rest.start()
        elif a1 is not None and a1.type() == QEvent.Type.Hide:
            self._rest.stop()
        return super().eventFilter(a0, a1)

    def _choose(self, figure: str) -> None:
        self._figure = figure
        self._ask()

    def _frame_shown(self, _: int) -> None:
        if self._panel.isVisible():
            self._panel.show_empty("")
            self._rest.start()

    def _ask(self) -> None:
        controller, latest = self._controller, self._controller.latest_frame
        if (
            latest is None
            or not self._panel.isVisible()
            or controller.window.timeline.is_playing
            or not controller.is_idle
        ):
            return
        known = [name for name in latest.metrics if METRICS[name.partition(".")[2]].better == "lower"]
        figure = self._figure if self._figure in known else next(iter(known), "")
        self._panel.offer_metrics(known, figure)
        if not figure:
            self._panel.show_empty(_NO_TRUTH)
            return
        session, evaluator = controller.session, controller.evaluator
        self._panel.show_empty("putting the truth in place of one slot after the other…")
        self._ticket = controller.submit_priority(
            lambda report: evaluator.attribute_frame_error(session, figure, report)
        )

    def _opened(self, _: int, part: object) -> None:
        if isinstance(part, Translation):
            self._panel.show_empty("")

    def _take(self, ticket: int, found: object) -> None:
        if ticket != self._ticket or not isinstance(found, ErrorAttribution):
            return
        parts = [(part.title, part.share) for part in found.shares]
        self._panel.show_attribution(found.summary, make_bars(found.total, parts, found.remainder), found.unit)
