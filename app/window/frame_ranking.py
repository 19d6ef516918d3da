"""Ranks all frames of a recording, computed at lowest priority while the frames table or the timeline needs them."""

from __future__ import annotations

from PyQt6.QtCore import QObject, Qt, QTimer

from app.session.state import Session
from app.window.session_controller import SessionController
from app.work.evaluator import SummarisedFrame
from pipeline.metrics.stage_metrics import METRICS, describe_metric
from pipeline.translation.error_attribution import DEFAULT_METRIC
from widgets.styling import make_single_shot_timer

_TIMELINE_DELAY_MS = 60  # summaries that arrive within it are drawn together
_NO_TRUTH = "recording without truth"
_DELAY_MS = 400  # browsing and error attribution come first


class FrameRankingController(QObject):
    """Computes the unknown frame nearest to the one on screen, one after the other, at lowest priority."""

    def __init__(self, controller: SessionController) -> None:
        super().__init__(controller)
        self._controller, self._panel = controller, controller.window.frames
        self._metric, self._ticket = DEFAULT_METRIC, 0
        self._timer = QTimer(self)
        self._timer.setSingleShot(True)
        self._timer.timeout.connect(self._rank_next)
        controller.window.drawers.frames.visibilityChanged.connect(self._set_visible)
        controller.frame_shown.connect(self._frame_shown)
        controller.closing.connect(self._timer.stop)
        controller.job.finished.connect(self._show_summary)
        self._panel.metric_chosen.connect(self._choose_metric)
        window = controller.window
        self._panel.model.dataChanged.connect(self._update_timeline_soon)
        self._panel.model.modelReset.connect(self._update_timeline_soon)
        self._timeline_timer = make_single_shot_timer(self, _TIMELINE_DELAY_MS, self._update_timeline)
        self._panel.model.note_edited.connect(self._set_note)
        window.connect_command("worst_frame", self._go_to_worst)
        window.connect_command("worse_frame", lambda: self._step(-1))
        window.connect_command("better_frame", lambda: self._step(1))

    def _choose_metric(self, metric: str) -> None:
        self._metric = metric
        self._offer_metrics()
        self._update_timeline()

    def _go_to_worst(self) -> None:
        worst = self._controller.window.timeline.errors.worst_frame
        if worst >= 0:
            self._controller.choose_frame(worst)

    def _set_note(self, frame: int, text: str) -> None:
        """Store the note of a frame in the session."""
        others = {at: note for at, note in self._controller.session.notes.items() if at != frame}
        self._controller.change(f"note on frame {frame}", notes={**others, frame: text} if text else others)

    def show_session(self, session: Session) -> None:
        """Show the notes in the frames table."""
        self._panel.model.show_notes(session.notes)

    def _update_timeline_soon(self) -> None:
        if not self._timeline_timer.isActive():
            self._timeline_timer.start()

    def _update_timeline(self) -> None:
        """Show metric and warnings of the table on the timeline, without warnings that every frame has."""
        model = self._panel.model
        warnings = {i: texts for i in range(model.rowCount()) if (texts := model.get_specific_warnings(i))}
        values = model.get_values(self._metric) if model.rowCount() > 1 else ()
        opened = self._controller.views.translation
        text = "no known error" if opened is None or opened.stream.has_truth else _NO_TRUTH
        self._controller.window.timeline.show_errors(describe_metric(self._metric), values, warnings, text)

    @property
    def _is_needed(self) -> bool:
        """Whether the table is visible, or the recording has truth, whose errors the timeline shows."""
        opened = self._controller.views.translation
        return self._controller.window.drawers.frames.isVisible() or (opened is not None and opened.stream.has_truth)

    def _step(self, by: int) -> None:
        self._panel.step_by_metric(by, sort_order=_get_sort_order(self._metric))

    def _set_visible(self, visible: bool) -> None:
        if visible:
            self._rank_soon(_DELAY_MS)

    def _frame_shown(self, _: int) -> None:
        self._rank_soon(_DELAY_MS)

    def _rank_soon(self, ms: int) -> None:
        self._offer_metrics()
        if self._is_needed:
            self._timer.start(ms)

    def _rank_next(self) -> None:
        controller = self._controller
        frame = self._panel.model.find_unknown_frame(controller.session.frame)
        if frame < 0 or controller.window.timeline.is_playing or not controller.is_idle:
            return
        session, evaluator = controller.session, controller.evaluator
        self._ticket = controller.submit_background(
            lambda report: evaluator.evaluate_in_background(session, frame, report)
        )

    def _show_summary(self, ticket: int, result: object) -> None:
        if ticket == self._ticket and isinstance(result, SummarisedFrame):
            if result.settings == self._controller.session.settings:
                self._panel.model.show_summary(result.index, result.summary)
            self._rank_soon(0)
        elif self._is_needed and not self._timer.isActive():
            self._timer.start(_DELAY_MS)

    def _offer_metrics(self) -> None:
        """Offer the known metrics."""
        names = [name for name in self._panel.model.metrics if METRICS[name.partition(".")[2]].better != "neither"]
        if names and self._metric not in names:  # not known of any frame yet
            names.insert(0, self._metric)
        unit = METRICS[self._metric.partition(".")[2]].unit
        self._panel.offer_metrics(tuple(names), self._metric, f"error\n{unit}" if self._is_error else f"value\n{unit}")

    @property
    def _is_error(self) -> bool:
        return METRICS[self._metric.partition(".")[2]].better == "lower"


def _get_sort_order(metric: str) -> Qt.SortOrder:
    lower = METRICS[metric.partition(".")[2]].better == "lower"
    return Qt.SortOrder.DescendingOrder if lower else Qt.SortOrder.AscendingOrder
