"""All frames of a recording, worked out beside everything else while somebody sees their table."""

from __future__ import annotations

from PyQt6.QtCore import QObject, Qt, QTimer

from app.session.state import Session
from app.window.session_controller import SessionController
from app.work.evaluator import SummarisedFrame
from pipeline.metrics.stage_metrics import METRICS, describe_metric
from pipeline.translation.error_attribution import DEFAULT_METRIC as FIRST_CHOICE
from widgets.styling import make_single_shot_timer

_TOGETHER_MS = 60  # frames that become known within this are drawn once
_NO_TRUTH = "the recording holds no truth"
_AT_REST_MS = 400  # who looks for a frame, or has its error taken apart, comes first


class FrameRankingController(QObject):
    """Asks for the unknown frame nearest to the one on screen, one after the other; anything else goes before it."""

    def __init__(self, controller: SessionController) -> None:
        super().__init__(controller)
        self._controller, self._panel = controller, controller.window.frames
        self._figure, self._ticket = FIRST_CHOICE, 0
        self._rest = QTimer(self)
        self._rest.setSingleShot(True)
        self._rest.timeout.connect(self._ask)
        controller.window.drawers.frames.visibilityChanged.connect(self._seen)
        controller.frame_shown.connect(self._frame_shown)
        controller.closing.connect(self._rest.stop)
        controller.job.finished.connect(self._take)
        self._panel.metric_chosen.connect(self._choose)
        window = controller.window
        self._panel.model.dataChanged.connect(self._tell_soon)
        self._panel.model.modelReset.connect(self._tell_soon)
        self._told = make_single_shot_timer(self, _TOGETHER_MS, self._tell)
        self._panel.model.note_edited.connect(self._note)
        controller.session_shown.connect(self._show_notes)
        window.connect_command("worst_frame", self._go_to_worst)
        window.connect_command("worse_frame", lambda: self._step(-1))
        window.connect_command("better_frame", lambda: self._step(1))

    def _choose(self, figure: str) -> None:
        self._figure = figure
        self._offer()
        self._tell()

    def _go_to_worst(self) -> None:
        worst = self._controller.window.timeline.errors.worst_frame
        if worst >= 0:
            self._controller.choose_frame(worst)

    def _note(self, frame: int, text: str) -> None:
        """Keep what somebody wrote of a frame in the session."""
        others = {at: kept for at, kept in self._controller.session.notes.items() if at != frame}
        self._controller.change(f"note frame {frame}", notes={**others, frame: text} if text else others)

    def _show_notes(self, session: Session) -> None:
        self._panel.model.show_notes(session.notes)

    def _tell_soon(self) -> None:
        if not self._told.isActive():
            self._told.start()

    def _tell(self) -> None:
        """The timeline shows what the table knows; doubts that every frame has tell none from another."""
        known = self._panel.model
        doubts = {i: own for i in range(known.rowCount()) if (own := known.get_specific_warnings(i))}
        values = known.get_values(self._figure) if known.rowCount() > 1 else ()
        opened = self._controller.views.translation
        without = "no error known" if opened is None or opened.stream.has_truth else _NO_TRUTH
        self._controller.window.timeline.show_errors(describe_metric(self._figure), values, doubts, without)

    @property
    def _wanted(self) -> bool:
        """Whether somebody sees the table, or errors can be known, which the timeline shows."""
        opened = self._controller.views.translation
        return self._controller.window.drawers.frames.isVisible() or (opened is not None and opened.stream.has_truth)

    def _step(self, by: int) -> None:
        self._panel.step_by_metric(by, sort_order=_worst_first(self._figure))

    def _seen(self, seen: bool) -> None:
        if seen:
            self._soon(_AT_REST_MS)

    def _frame_shown(self, _: int) -> None:
        self._soon(_AT_REST_MS)

    def _soon(self, ms: int) -> None:
        self._offer()
        if self._wanted:
            self._rest.start(ms)

    def _ask(self) -> None:
        controller = self._controller
        frame = self._panel.model.find_unknown_frame(controller.session.frame)
        if frame < 0 or controller.window.timeline.is_playing or not controller.is_idle:
            return
        session, evaluator = controller.session, controller.evaluator
        self._ticket = controller.submit_background(
            lambda report: evaluator.evaluate_in_background(session, frame, report)
        )

    def _take(self, ticket: int, found: object) -> None:
        if ticket == self._ticket and isinstance(found, SummarisedFrame):
            if found.settings == self._controller.session.settings:
                self._panel.model.show_summary(found.index, found.summary)
            self._soon(0)
        elif self._wanted and not self._rest.isActive():
            self._rest.start(_AT_REST_MS)

    def _offer(self) -> None:
        """The figures that are known by now, errors first."""
        names = [name for name in self._panel.model.metrics if METRICS[name.partition(".")[2]].better != "neither"]
        if names and self._figure not in names:  # not known of any frame yet: it stays chosen, and others can be
            names.insert(0, self._figure)
        unit = METRICS[self._figure.partition(".")[2]].unit
        self._panel.offer_metrics(tuple(names), self._figure, f"error\n{unit}" if self._errs else f"figure\n{unit}")

    @property
    def _errs(self) -> bool:
        return METRICS[self._figure.partition(".")[2]].better == "lower"


def _worst_first(figure: str) -> Qt.SortOrder:
    lower = METRICS[figure.partition(".")[2]].better == "lower"
    return Qt.SortOrder.DescendingOrder if lower else Qt.SortOrder.AscendingOrder
