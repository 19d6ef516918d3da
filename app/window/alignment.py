"""The alignment dock at work: a drag previews, rest is judged, refining runs beside it all."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from PyQt6.QtCore import QObject, pyqtSignal

from app.session.state import Session
from app.window.alignment_refinement import RefinementController
from app.window.logs import log
from app.window.session_controller import SessionController
from app.work import alignment_jobs
from app.work.alignment_jobs import AlignmentAssessment, BeforeAfter, DragPreview
from app.work.jobs import JobReporter
from pipeline.alignment.score import AlignmentScore
from pipeline.base.arrays import Doubles
from pipeline.base.errors import SettingProblem, TouchError
from pipeline.geometry import rigid
from pipeline.sensors.alignment_files import AlignmentFile, save_alignment
from pipeline.sensors.offsets import AXES, Axis, Offsets
from pipeline.translation.translate import Translation
from widgets.styling import make_single_shot_timer

_AT_REST_MS = 120  # a frame on screen for less than this is not judged: it is being played or searched through
_DEPTH_FULL_MM = {"gel": 0.5, "bubble": 2.0}  # where the gauge of depth is full
_SAME_PLACE_MM = 1e-6


class AlignmentController(QObject):
    """Between the dock and the controller: nothing runs while nobody sees the dock. `placed` when the touch moved."""

    contact_moved = pyqtSignal()

    def __init__(self, controller: SessionController) -> None:
        super().__init__(controller)
        self._controller, self._panel = controller, controller.window.alignment
        self.refinement = RefinementController(controller)
        self._offsets = Offsets()  # as the handles stand
        self._axis = ""
        self._judged: AlignmentAssessment | None = None
        self._score: AlignmentScore | None = None
        self._judging = 0
        self._seen = False
        self._rest = make_single_shot_timer(self, _AT_REST_MS, self._judge)
        self._connect()

    def _connect(self) -> None:
        controller, panel = self._controller, self._panel
        controller.session_shown.connect(self.show_session)
        controller.frame_shown.connect(self._frame_shown)
        controller.closing.connect(self._rest.stop)
        self.refinement.proposal_changed.connect(self._answered)
        controller.job.delivered.connect(self._take)
        controller.job.finished.connect(self._take_last)
        controller.job.failed.connect(self._not_judged)
        controller.job.cancelled.connect(self._not_judged)
        panel.drag_started.connect(self._begin)
        panel.offset_changed.connect(self._move)
        panel.drag_ended.connect(self._end)
        panel.reset_requested.connect(lambda: controller.change("reset the alignment", offsets=Offsets()))
        panel.pivot_requested.connect(self._turn_about_this_touch)
        panel.original_requested.connect(lambda: controller.change("go back to the recorded alignment", alignment=None))
        controller.window.drawers.alignment.visibilityChanged.connect(self._show_seen)

    @property
    def is_idle(self) -> bool:
        """Whether the dock shows all that it will show."""
        return not (self._panel.dragging or self._rest.isActive() or self._judging or self.refinement.is_busy)

    @property
    def offsets(self) -> Offsets:
        """As the handles stand."""
        return self._offsets

    @property
    def contact_centre_mm(self) -> Doubles | None:
        """Where the middle of the contact is carried to (3,), in the target frame; None while that is not known."""
        return None if self._judged is None else rigid.apply(self._offsets.to_matrix(), self._judged.pivot_mm)

    def show_session(self, session: Session) -> None:
        """Show a session's offsets; one that is undone under a drag ends it."""
        if not self._panel.dragging:
            self._offsets = session.offsets
            self._panel.show_values(session.offsets.values)
            self._show_place()
        self.refinement.show_session(session)

    def save_alignment(self, path: Path) -> None:
        """Write the alignment with its offsets as TOML; errors end in the banner."""
        opened, session = self._controller.views.translation, self._controller.session
        try:
            if opened is None:
                raise SettingProblem("there is no alignment to save; open a recording first")
            how = "opened with" if session.offsets.is_zero else "moved or refined on"
            kept = AlignmentFile(
                alignment=session.offsets.apply_to(opened.alignment), source=opened.source.name,
                target=opened.target.name, origin=f"{how} {opened.request.recording.name}",
            )  # fmt: skip
            save_alignment(path, kept)
            log.info("alignment saved: '%s'", path)
        except TouchError as error:
            self._controller.show_problem(error)

    def _show_seen(self, seen: bool) -> None:
        self._seen = seen
        self._controller.set_observation_outline(seen)
        if not seen:
            self._rest.stop()

    def _frame_shown(self, _: int) -> None:
        if self._seen and not self._panel.dragging:
            self._rest.start()

    def _judge(self) -> None:
        controller = self._controller
        if not self._seen or controller.window.timeline.is_playing or not controller.is_idle:
            return
        session, evaluator = controller.session, controller.evaluator
        answer = self.refinement.proposal

        def work(report: JobReporter) -> AlignmentAssessment:
            if answer is not None:
                report.deliver(alignment_jobs.draw_before_and_after(evaluator, session, answer.offsets, report))
            return alignment_jobs.assess_alignment(evaluator, session, report)

        self._judging = controller.submit_priority(work)

    def _answered(self) -> None:
        """A refinement is looked at beside what is, on every frame until it is taken or not."""
        if self.refinement.proposal is not None:
            self._frame_shown(0)
        elif not self._controller.is_closed:
            self._controller.refresh()

    def _begin(self) -> None:
        self._rest.stop()
        self._controller.window.timeline.play(on=False)
        self._panel.mark_ghosts(self._score)
        offsets = self._controller.session.offsets
        if self._judged is not None and not any(offsets.rotation_deg):
            x, y, z = (float(v) for v in self._judged.pivot_mm)
            offsets = replace(offsets, pivot_mm=(x, y, z))  # of a mere shift it may be anywhere
        self._offsets = offsets
        self._axis = ""
        self._show_place()

    def _move(self, axis: str, value: float) -> None:
        controller = self._controller
        known: Axis = next(a for a in AXES if a == axis)
        self._axis = known if self._axis in ("", known) else "axes"
        self._offsets = self._offsets.with_axis_value(known, value)
        self._show_place()
        session, evaluator = replace(controller.session, offsets=self._offsets), controller.evaluator
        controller.submit_priority(lambda report: alignment_jobs.preview_drag(evaluator, session, report))

    def _end(self) -> None:
        """The whole drag is one change; the stages run again even if it ended where it began."""
        controller = self._controller
        if self._offsets.values == controller.session.offsets.values:
            controller.refresh()
            return
        controller.change(f"move the alignment ({self._axis})", offsets=self._offsets)

    def _turn_about_this_touch(self) -> None:
        if self._judged is not None:
            offsets = self._controller.session.offsets.with_pivot(self._judged.pivot_mm)
            self._controller.change("turn about this touch", offsets=offsets)

    def _take_last(self, ticket: int, part: object) -> None:
        self._take(ticket, part)
        self._not_judged(ticket)

    def _not_judged(self, ticket: int, _: object = None) -> None:
        """Nothing more will come for this ticket."""
        if ticket == self._judging:
            self._judging = 0

    def _take(self, ticket: int, part: object) -> None:
        if isinstance(part, Translation):
            self._judged = self._score = None
            self._panel.show_empty()
        elif isinstance(part, BeforeAfter) and ticket == self._judging and self.refinement.proposal is not None:
            self._controller.views.show_wipe(part.before, part.after)
        elif isinstance(part, DragPreview) and self._panel.dragging:
            self._controller.views.show_drag_preview(part.preview, part.observation_view, part.layers)
            self._show_score(part.score)
        elif isinstance(part, AlignmentAssessment) and ticket == self._judging and not self._panel.dragging:
            self._show_judged(part)

    def _show_judged(self, judged: AlignmentAssessment) -> None:
        self._judged = judged
        opened = self._controller.views.translation
        if opened is not None:
            target = opened.target
            self._panel.show_ready(target.name, _DEPTH_FULL_MM[target.sensor_kind.display_group], target.pixel_mm)
        self._panel.show_score(judged.score, judged.no_score_reason)
        self._score = judged.score
        if judged.sensitivities or judged.score is None:
            self._panel.show_sensitivities(judged.sensitivities)
        self._show_place()

    def _show_score(self, score: AlignmentScore | None) -> None:
        self._score = score
        self._panel.show_score(score, self._panel.no_score_reason)

    def _show_place(self) -> None:
        """Whose alignment it is, and where turns are about."""
        opened, judged, offsets = self._controller.views.translation, self._judged, self._offsets
        self.contact_moved.emit()
        if opened is None or judged is None:
            return
        here = tuple(float(v) for v in judged.pivot_mm)
        about = offsets.pivot_mm if any(offsets.rotation_deg) else here
        elsewhere = max(abs(a - b) for a, b in zip(about, here, strict=True)) > _SAME_PLACE_MM
        self._panel.show_pivot(about, opened.target.name, elsewhere=elsewhere)
        file = self._controller.session.alignment
        self._panel.show_origin(judged.origin, edited=not offsets.is_zero, from_file=file is not None)
