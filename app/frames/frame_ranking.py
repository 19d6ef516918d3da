"""Ranks all frames of a recording, computed at lowest priority while the frames table or the
timeline needs them.

With truth they are ranked by an error, without it by the round trip to the target and back. Force
takes the depth of a frame alone, so that it comes before all else where it is chosen.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

from PyQt6.QtCore import Qt

from app.document.feature import Feature
from app.document.session_controller import SessionController
from app.session.state import Session
from pipeline.stages.metrics.stage_metrics import METRICS, ROUND_TRIP, Metric, describe_metric
from pipeline.translation.error_attribution import DEFAULT_METRIC
from pipeline.translation.force import list_force_metrics
from widgets.frames.frame_summary import FRAME_FIGURES
from widgets.style.styling import make_single_shot_timer

_TIMELINE_DELAY_MS = 60  # summaries that arrive within it are drawn together
_UNCALIBRATED = "uncalibrated_"  # before the name of a force whose scale is not known
_DELAY_MS = 400  # browsing and error attribution come first


class FrameRankingController(Feature):
    """Computes the unknown frame nearest to the one on screen, one after the other, at lowest
    priority.
    """

    def __init__(self, controller: SessionController) -> None:
        super().__init__(controller)
        self._panel = self._window.frames
        # "" = as the recording has truth or not
        self._chosen_metric = ""
        self._timer = make_single_shot_timer(self, _DELAY_MS, self._rank_next)
        controller.window.drawers.frames.visibilityChanged.connect(self._set_visible)
        controller.job.finished.connect(self._go_on)
        self._panel.metric_box.chosen.connect(self._choose_metric)
        window = controller.window
        self._panel.model.dataChanged.connect(self._update_timeline_soon)
        self._panel.model.modelReset.connect(self._update_timeline_soon)
        self._timeline_timer = make_single_shot_timer(
            self, _TIMELINE_DELAY_MS, self._update_timeline
        )
        self._panel.model.note_edited.connect(self._set_note)
        window.connect_command("worst_frame", self._go_to_worst)
        window.connect_command("worse_frame", lambda: self._step(-1))
        window.connect_command("better_frame", lambda: self._step(1))

    def _choose_metric(self, metric: str) -> None:
        self._chosen_metric = metric
        self._offer_metrics()
        self._update_timeline()
        self._rank_soon(_DELAY_MS)

    @property
    def _has_truth(self) -> bool:
        """Whether the recording knows the depth of the target's touch."""
        opened = self._translation
        other = None if opened is None else opened.recording.stream_of_sensor(opened.target.name)
        return opened is None or (other is not None and other.has_truth)

    @property
    def _metric(self) -> str:
        """The metric that ranks the frames; forces follow the calibration that is loaded."""
        for metric in self._force_metrics:
            if metric.replace(_UNCALIBRATED, "") == self._chosen_metric.replace(_UNCALIBRATED, ""):
                return metric
        return self._chosen_metric or (DEFAULT_METRIC if self._has_truth else ROUND_TRIP)

    @property
    def _force_metrics(self) -> tuple[str, ...]:
        """The metrics of the open recording's force; empty without a contact model."""
        opened = self._translation
        return () if opened is None else list_force_metrics(opened)

    def _go_to_worst(self) -> None:
        worst = self._window.timeline.errors.worst_frame
        if worst >= 0:
            self._controller.choose_frame(worst)

    def _set_note(self, frame: int, text: str) -> None:
        """Store the note of a frame in the session."""
        others = {at: note for at, note in self._session.notes.items() if at != frame}
        self._change(f"note on frame {frame}", notes={**others, frame: text} if text else others)

    def show_session(self) -> None:
        """Show the notes in the frames table."""
        self._panel.model.show_notes(self._session.notes)

    def _update_timeline_soon(self) -> None:
        if not self._timeline_timer.isActive():
            self._timeline_timer.start()

    def _update_timeline(self) -> None:
        """Show metric and warnings of the table on the timeline, without warnings that every
        frame has.
        """
        model = self._panel.model
        found = {i: model.get_specific_warnings(i) for i in range(model.rowCount())}
        warnings = {i: texts for i, texts in found.items() if texts}
        values = model.get_values(self._metric) if model.rowCount() > 1 else ()
        self._window.timeline.errors.show_thumbnails(model.thumbnails)
        self._window.timeline.show_errors(
            describe_metric(self._metric),
            values,
            warnings,
            is_quantity=self._figure.better == "neither",
        )

    @property
    def _needs_completion(self) -> bool:
        """Whether the table is visible, or the timeline shows what takes another translation."""
        return self._window.drawers.frames.isVisible() or self._metric == ROUND_TRIP

    @property
    def _is_needed(self) -> bool:
        """Whether the table is visible, or the timeline shows a recording that does not grow."""
        opened = self._translation
        is_whole = opened is not None and opened.recording.refresh is None
        return is_whole or self._window.drawers.frames.isVisible()

    def _step(self, by: int) -> None:
        order = Qt.SortOrder
        is_best_last = self._figure.better == "higher"
        self._panel.step_by_metric(
            by, sort_order=order.AscendingOrder if is_best_last else order.DescendingOrder
        )

    def _set_visible(self, visible: bool) -> None:
        if visible:
            self._rank_soon(_DELAY_MS)

    def show_frame(self) -> None:
        """Go on with the others."""
        self._rank_soon(_DELAY_MS)

    def _rank_soon(self, ms: int) -> None:
        self._offer_metrics()
        if self._is_needed:
            self._timer.start(ms)

    def _rank_next(self) -> None:
        controller = self._controller
        model = self._panel.model
        if self._measure_force():
            return
        frame = model.find_unknown_frame(controller.session.frame)
        if completely := frame < 0 and self._needs_completion:
            frame = model.find_unknown_frame(controller.session.frame, completely=True)
        if frame < 0 or controller.window.timeline.is_playing or not controller.is_idle:
            return
        session = controller.session
        evaluator = controller.evaluator
        controller.submit_priority(
            lambda report: evaluator.evaluate_in_background(
                session, frame, report, completely=completely
            ),
            partial(self._show, model.show_summary, frame, session),
            background=True,
        )

    def _measure_force(self) -> bool:
        """Measure the force of the next frame if the metric is the force.

        Return whether any is left to measure.
        """
        controller = self._controller
        metric = self._metric
        if metric not in self._force_metrics:
            return False
        session = controller.session
        evaluator = controller.evaluator
        frame = self._panel.model.find_unknown_frame(session.frame, quantity=metric)
        if frame >= 0 and not controller.window.timeline.is_playing and controller.is_idle:
            controller.submit_priority(
                lambda report: evaluator.measure_force_in_background(
                    session, frame, metric, report
                ),
                partial(self._show, self._panel.model.show_quantities, frame, session),
                background=True,
            )
        return frame >= 0

    def _show(
        self, show: Callable[[int, Any], None], frame: int, session: Session, known: object
    ) -> None:
        """Show what is known of a frame now, and go on with the next."""
        if session.settings == self._session.settings:
            show(frame, known)
        self._rank_soon(0)

    def _go_on(self) -> None:
        """Rank again after what came first."""
        if self._is_needed and not self._timer.isActive():
            self._timer.start(_DELAY_MS)

    def _offer_metrics(self) -> None:
        """Offer the known metrics, those of the whole frame last."""
        known = self._panel.model.metrics
        names = [name for name in known if METRICS[name.partition(".")[2]].better != "neither"]
        more = (ROUND_TRIP, *self._force_metrics, *FRAME_FIGURES)
        names = [name for name in dict.fromkeys((*names, *more)) if name != self._metric]
        names.sort(key=lambda name: name.startswith("frame."))  # stable
        texts = {name: describe_metric(name) for name in (self._metric, *names)}
        unit = self._figure.unit
        what = "error" if self._figure.better == "lower" else "value"
        self._panel.offer_metrics(texts, self._metric, f"{what}\n{unit}")

    @property
    def _figure(self) -> Metric:
        return METRICS[self._metric.partition(".")[2]]
