"""The alignment dock: dragging previews the alignment, a frame at rest is assessed, refinement
runs in parallel.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
from PyQt6.QtCore import pyqtSignal

from app.align import alignment_jobs
from app.align.alignment_jobs import AlignmentAssessment, BeforeAfter, DragPreview
from app.align.alignment_refinement import RefinementController
from app.document.feature import Feature
from app.document.session_controller import SessionController
from app.window.jobs import JobReporter
from app.window.logs import log
from pipeline.core.arrays import Doubles
from pipeline.core.errors import SettingProblem, TouchError
from pipeline.core.geometry import rigid
from pipeline.sensors.alignment import (
    AXES,
    AlignmentFile,
    Axis,
    Offsets,
    compose_motion,
    decompose_motion,
    save_alignment,
)
from pipeline.translation.alignment.score import AlignmentScore
from pipeline.views.view import to_xyz
from widgets.style.styling import make_single_shot_timer

_ASSESS_DELAY_MS = 120  # frames shown for less are not assessed: the user is playing or browsing
_DEPTH_GAUGE_MM = {"gel": 0.5, "bubble": 2.0}  # full scale of the depth gauge, by kind of sensor
_SAME_PIVOT_MM = 1e-6


class AlignmentController(Feature):
    """Connects the dock with the session; nothing is computed while the dock is hidden."""

    contact_moved = pyqtSignal()
    # offsets, or None: the drag has ended; layers of the target depth, or None: not there yet
    dragged = pyqtSignal(object, object)

    def __init__(self, controller: SessionController) -> None:
        super().__init__(controller)
        self._panel = self._window.alignment
        self.refinement = RefinementController(controller)
        self.offsets = Offsets()  # of the handles, also during a drag
        self._grabbed = Offsets()
        self._axis = ""
        self._recording: Path | None = None
        self._assessment: AlignmentAssessment | None = None
        self._score: AlignmentScore | None = None
        self._is_visible = False
        self._assess_timer = make_single_shot_timer(self, _ASSESS_DELAY_MS, self._assess)
        self._connect()

    def _connect(self) -> None:
        controller = self._controller
        panel = self._panel
        self.refinement.proposal_changed.connect(self._proposal_changed)
        panel.drag_started.connect(self._begin_drag)
        panel.offset_changed.connect(self._drag)
        panel.drag_ended.connect(self._end_drag)
        panel.reset.clicked.connect(lambda: controller.change("reset alignment", offsets=Offsets()))
        panel.here.clicked.connect(self._set_pivot_to_contact)
        panel.original.clicked.connect(
            lambda: controller.change("use recorded alignment", alignment=None)
        )
        controller.window.drawers.alignment.visibilityChanged.connect(self._set_visible)

    @property
    def is_idle(self) -> bool:
        """Whether the dock is up to date."""
        return self._controller.job.is_settled and not (
            self._panel.dragging or self._assess_timer.isActive() or self.refinement.is_refining
        )

    @property
    def contact_centre_mm(self) -> Doubles | None:
        """Centre of contact (3,) mm in the target frame under the offsets; None if not assessed."""
        if self._assessment is None:
            return None
        return rigid.apply(self.offsets.to_matrix(), self._assessment.pivot_mm)

    def show_session(self) -> None:
        """Show a session's offsets, unless a drag is running; nothing of the recording before."""
        session = self._session
        if session.recording != self._recording:
            self._recording = session.recording
            self.show_translation()
        if not self._panel.dragging:
            self.offsets = session.offsets
            self._panel.show_values(session.offsets.values)
            self._show_pivot()

    def save_alignment(self, path: Path) -> None:
        """Write the alignment with its offsets as TOML; errors go to the banner."""
        opened = self._translation
        session = self._session
        try:
            if opened is None:
                raise SettingProblem("no alignment to save; open a recording first")
            how = "opened with" if session.offsets.is_zero else "moved or refined on"
            file = AlignmentFile(
                alignment=session.offsets.apply_to(opened.alignment),
                source=opened.source.name,
                target=opened.target.name,
                origin=f"{how} {opened.request.recording.name}",
            )
            save_alignment(path, file)
            log.info("alignment saved: '%s'", path)
            self._use_saved_file(path)
        except TouchError as error:
            self._controller.show_problem(error)

    def _use_saved_file(self, path: Path) -> None:
        """Open the saved file in place of the offsets it holds: the dock is clean, and no change
        is unsaved.
        """
        controller = self._controller
        controller.saved_session = replace(controller.saved_session, offsets=Offsets())
        controller.change("save alignment", alignment=path, offsets=Offsets())

    def _set_visible(self, visible: bool) -> None:
        self._is_visible = visible
        self._controller.request_extra("observation", wanted=visible)
        if not visible:
            self._assess_timer.stop()

    def show_frame(self) -> None:
        """Assess a frame that stays."""
        if self._is_visible and not self._panel.dragging:
            self._assess_timer.start()

    def _assess(self) -> None:
        controller = self._controller
        if not self._is_visible or controller.window.timeline.is_playing or not controller.is_idle:
            return
        session = controller.session
        evaluator = controller.evaluator
        proposal = self.refinement.proposal

        def work(report: JobReporter) -> AlignmentAssessment:
            if proposal is not None:
                report.deliver(
                    alignment_jobs.draw_before_and_after(
                        evaluator, session, proposal.offsets, report
                    )
                )
            return alignment_jobs.assess_alignment(evaluator, session, report)

        controller.submit_priority(work, self._show_part)

    def _proposal_changed(self) -> None:
        """Show a proposed refinement against the current alignment, until it is accepted or
        discarded.
        """
        if self.refinement.proposal is not None:
            self.show_frame()
        elif not self._controller.is_closed:
            self._controller.refresh()

    def _begin_drag(self) -> None:
        self._assess_timer.stop()
        self._window.timeline.play(on=False)
        self._panel.mark_ghosts(self._score)
        offsets = self._session.offsets
        if self._assessment is not None and not any(offsets.rotation_deg):
            # a translation does not depend on the pivot
            offsets = replace(offsets, pivot_mm=to_xyz(self._assessment.pivot_mm))
        self.offsets = offsets
        self._axis = ""
        self._show_pivot()

    def grab(self) -> None:
        """Begin a drag of a gizmo."""
        self._panel.begin_drag()
        self._grabbed = self.offsets

    def drag_motion(self, shift_mm: Doubles, rotation: Doubles) -> None:
        """Move by a translation (3,) and a rotation (3, 3) about the contact since `grab`."""
        start = self._grabbed
        centre_mm = start.pivot_mm if self._assessment is None else self._assessment.pivot_mm
        about = rigid.apply(start.to_matrix(), centre_mm)
        turn = np.eye(4)
        turn[:3, :3] = rotation
        motion = compose_motion(about, rigid.rotation_vector_rad(turn), shift_mm)
        self._axis = "axes"
        self.offsets = decompose_motion(motion @ start.to_matrix(), start.pivot_mm)
        self._panel.show_values(self.offsets.values)
        self._preview_drag()

    def _drag(self, axis: str, value: float) -> None:
        name: Axis = next(a for a in AXES if a == axis)
        self._axis = name if self._axis in ("", name) else "axes"
        self.offsets = self.offsets.with_axis_value(name, value)
        self._preview_drag()

    def _preview_drag(self) -> None:
        self._show_pivot()
        self.dragged.emit(self.offsets, None)
        session = replace(self._session, offsets=self.offsets)
        evaluator = self._controller.evaluator
        self._controller.submit_priority(
            lambda report: alignment_jobs.preview_drag(evaluator, session, report), self._show_part
        )

    def _end_drag(self) -> None:
        """Make the whole drag one undo step; without a change the stages are computed again."""
        self.dragged.emit(None, None)
        if self.offsets.values == self._session.offsets.values:
            self._controller.refresh()
        else:
            self._change(f"move alignment ({self._axis})", offsets=self.offsets)

    def _set_pivot_to_contact(self) -> None:
        if self._assessment is not None:
            offsets = self._session.offsets.with_pivot(self._assessment.pivot_mm)
            self._change("set pivot to contact", offsets=offsets)

    def show_translation(self) -> None:
        """Show nothing of the alignment before."""
        self._assessment = self._score = None
        self._panel.show_empty()

    def _show_part(self, part: BeforeAfter | DragPreview | AlignmentAssessment) -> None:
        if isinstance(part, BeforeAfter):
            if self.refinement.proposal is not None:
                self._views.show_wipe(part.before, part.after)
        elif isinstance(part, DragPreview) and self._panel.dragging:
            self._views.show_drag_preview(part.preview, part.observation_view)
            self.dragged.emit(self.offsets, part.layers)
            self._show_score(part.score)
        elif isinstance(part, AlignmentAssessment) and not self._panel.dragging:
            self._show_judged(part)

    def _show_judged(self, assessment: AlignmentAssessment) -> None:
        self._assessment = assessment
        if self._translation is not None:
            target = self._translation.target
            full_mm = _DEPTH_GAUGE_MM[target.sensor_kind.display_group]
            self._panel.show_ready(target.title, full_mm, target.pixel_mm)
        self._panel.show_score(assessment.score, assessment.no_score_reason)
        self._score = assessment.score
        if assessment.sensitivities or assessment.score is None:
            self._panel.show_sensitivities(assessment.sensitivities)
        self._show_pivot()

    def _show_score(self, score: AlignmentScore | None) -> None:
        self._score = score
        self._panel.show_score(score, self._panel.no_score_reason.text())

    def _show_pivot(self) -> None:
        """Show the origin of the alignment and the pivot of its rotations."""
        opened = self._translation
        assessment = self._assessment
        offsets = self.offsets
        self.contact_moved.emit()
        if opened is None or assessment is None:
            return
        contact = to_xyz(assessment.pivot_mm)
        pivot = offsets.pivot_mm if any(offsets.rotation_deg) else contact
        elsewhere = not np.allclose(pivot, contact, rtol=0.0, atol=_SAME_PIVOT_MM)
        self._panel.show_pivot(pivot, opened.target.title, elsewhere=elsewhere)
        from_file = self._session.alignment is not None
        self._panel.show_origin(assessment.origin, edited=not offsets.is_zero, from_file=from_file)
