"""The attribution of the error of a frame at rest to the stages, for verdict, cards and inspector
of *Look*.
"""

from PyQt6.QtCore import QEvent, pyqtSignal

from app.document.feature import Feature
from app.document.session_controller import SessionController
from pipeline.stages.metrics.stage_metrics import describe_metric, is_stage_error
from pipeline.stages.stage import TRUTH
from pipeline.translation.error_attribution import DEFAULT_METRIC, ErrorAttribution, ErrorShare
from pipeline.translation.translate import Translation
from widgets.frames.error_attribution_panel import make_bars
from widgets.style.base import EventListener
from widgets.style.styling import make_single_shot_timer

_DELAY_MS = 250  # attribution costs several frames of computation: not while playing or browsing
_NO_TRUTH = "This frame has no known error: the recording has no touch of the target."


class ErrorAttributionController(Feature):
    """Connects the waterfall with the session."""

    attributed = pyqtSignal(object)  # ErrorAttribution

    def __init__(self, controller: SessionController) -> None:
        super().__init__(controller)
        self._panel = self._window.error_attribution
        self._metric = DEFAULT_METRIC
        self._ticket = 0
        self._shares: tuple[ErrorShare, ...] = ()
        self._timer = make_single_shot_timer(self, _DELAY_MS, self._attribute)
        EventListener(self._window.look, self._timer.start, QEvent.Type.Show)
        EventListener(self._window.look, self._timer.stop, QEvent.Type.Hide)
        self._panel.metric_box.chosen.connect(self._choose_metric)
        self._panel.share_clicked.connect(self._toggle_truth)
        controller.frame_shown.connect(self._frame_shown)
        controller.job.delivered.connect(self._clear_for_translation)
        controller.job.finished.connect(self._show_attribution)

    def _choose_metric(self, metric: str) -> None:
        self._metric = metric
        self._attribute()

    def _frame_shown(self, _: int) -> None:
        self._panel.show_empty("")
        self._timer.start()

    def _attribute(self) -> None:
        controller = self._controller
        latest = self._controller.latest_frame
        if (
            latest is None
            or controller.session.layout.name != "look"
            or controller.window.timeline.is_playing
            or not controller.is_idle
        ):
            return
        known = [name for name in latest.metrics if is_stage_error(name)]
        metric = self._metric if self._metric in known else next(iter(known), "")
        self._panel.offer_metrics({name: describe_metric(name) for name in known}, metric)
        if not metric:
            self._panel.show_empty(_NO_TRUTH)
            return
        session = controller.session
        evaluator = controller.evaluator
        self._panel.show_empty("replacing one stage after the other by its truth…")
        self._ticket = controller.submit_priority(
            lambda report: evaluator.attribute_frame_error(session, metric, report)
        )

    def _clear_for_translation(self, _: int, part: object) -> None:
        if isinstance(part, Translation):
            self._panel.show_empty("")

    def _show_attribution(self, ticket: int, result: object) -> None:
        if ticket != self._ticket or not isinstance(result, ErrorAttribution):
            return
        self._shares = result.shares
        parts = [(part.title, part.share) for part in result.shares]
        self._panel.show_attribution(
            "Where the error comes from",
            make_bars("this frame's error", result.total, parts, result.remainder),
            result.unit,
        )
        self.attributed.emit(result)

    def _toggle_truth(self, share: int) -> None:
        """Pin the truth of the stage of a share in its column's head.

        A pinned stage is computed again.
        """
        controller = self._controller
        stage = self._shares[share].stage
        default = controller.route.methods[stage]
        is_pinned = controller.session.methods.get(stage) == TRUTH
        controller.choose_method(stage, default if is_pinned else TRUTH)
