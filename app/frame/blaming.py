"""The blame tab at work: a frame at rest has its error taken apart while somebody sees the tab."""

from __future__ import annotations

from PyQt6.QtCore import QEvent, QObject, QTimer

from app.frame.instrument import Instrument
from pipeline.evaluation.metrics import METRICS
from pipeline.translation.blame import FIGURE, Blame
from pipeline.translation.translate import Translation
from widgets.waterfall import bars

_AT_REST_MS = 250  # truth in five slots costs several times a frame: not while one is searched for or played
_NO_TRUTH = "no error is known of this frame: the recording does not hold what the target really felt"


class Blaming(QObject):
    """Between the tab and the instrument."""

    def __init__(self, instrument: Instrument) -> None:
        super().__init__(instrument)
        self._instrument, self._panel = instrument, instrument.window.blame
        self._figure, self._ticket = FIGURE, 0
        self._rest = QTimer(self)
        self._rest.setSingleShot(True)
        self._rest.setInterval(_AT_REST_MS)
        self._rest.timeout.connect(self._ask)
        self._panel.installEventFilter(self)
        self._panel.figure_chosen.connect(self._choose)
        instrument.frame_shown.connect(self._frame_shown)
        instrument.closing.connect(self._rest.stop)
        instrument.job.delivered.connect(self._opened)
        instrument.job.finished.connect(self._take)

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
            self._panel.show_nothing("")
            self._rest.start()

    def _ask(self) -> None:
        instrument, latest = self._instrument, self._instrument.latest
        if latest is None or not self._panel.isVisible() or instrument.window.timeline.playing or not instrument.idle:
            return
        known = [name for name in latest.metrics if METRICS[name.partition(".")[2]].better == "lower"]
        figure = self._figure if self._figure in known else next(iter(known), "")
        self._panel.offer_figures(known, figure)
        if not figure:
            self._panel.show_nothing(_NO_TRUTH)
            return
        session, evaluator = instrument.session, instrument.evaluator
        self._panel.show_nothing("putting the truth in place of one slot after the other…")
        self._ticket = instrument.ahead(lambda report: evaluator.blamed(session, figure, report))

    def _opened(self, _: int, part: object) -> None:
        if isinstance(part, Translation):
            self._panel.show_nothing("")

    def _take(self, ticket: int, found: object) -> None:
        if ticket != self._ticket or not isinstance(found, Blame):
            return
        parts = [(part.title, part.share) for part in found.parts]
        self._panel.show_blame(found.sentence, bars(found.total, parts, found.rest), found.unit)
