"""Refining in a thread of its own, so that one may look around meanwhile; its answer waits to be taken."""

from __future__ import annotations

from PyQt6.QtCore import QObject, pyqtSignal

from app.session.state import Session
from app.window.session_controller import SessionController
from app.work import alignment_jobs
from app.work.alignment_jobs import RefinementProposal
from app.work.jobs import LatestJob
from app.work.requests import make_request


class RefinementController(QObject):
    """Starts, shows, cancels, accepts. An answer for another alignment than the opened one is dropped."""

    proposal_changed = pyqtSignal()  # there is an answer to be looked at, or none any more

    def __init__(self, controller: SessionController) -> None:
        super().__init__(controller)
        self._controller, self._box = controller, controller.window.alignment.refine
        self._job = LatestJob("refine", self)
        self._begun: Session | None = None
        self._ticket = 0
        self.proposal: RefinementProposal | None = None
        self._job.progressed.connect(self._progressed)
        self._job.finished.connect(self._finished)
        self._job.failed.connect(self._failed)
        self._job.cancelled.connect(self._cancelled)
        self._box.refine_requested.connect(self.start)
        self._box.cancel_requested.connect(self._job.cancel)
        self._box.accepted.connect(self.accept)
        self._box.discarded.connect(self.discard)
        controller.closing.connect(self._job.close)

    @property
    def is_busy(self) -> bool:
        """Whether it runs."""
        return self._begun is not None and self.proposal is None

    def start(self) -> None:
        """Refine what is open."""
        opened, session = self._controller.views.translation, self._controller.session
        if opened is None:
            return
        self._begun, self.proposal = session, None
        self._box.show_progress(0.0, "opening the recording")
        self._ticket = self._job.submit(lambda report: alignment_jobs.propose_refinement(session, report))

    def accept(self) -> None:
        """Take the answer as one change."""
        answer = self.proposal
        self.discard()
        if answer is not None:
            self._controller.change("refine the alignment", offsets=answer.offsets)

    def discard(self) -> None:
        """Forget the answer."""
        seen, self._begun, self.proposal = self.proposal is not None, None, None
        self._box.show_idle()
        if seen:
            self.proposal_changed.emit()

    def show_session(self, session: Session) -> None:
        """Another recording or alignment is open: what was begun is of no use."""
        if self._begun is not None and make_request(session) != make_request(self._begun):
            self._job.cancel()
            self.discard()

    def _progressed(self, ticket: int, fraction: float, text: str) -> None:
        if ticket == self._ticket and self._begun is not None:
            self._box.show_progress(fraction, text)

    def _finished(self, ticket: int, answer: object) -> None:
        if ticket != self._ticket or self._begun is None or not isinstance(answer, RefinementProposal):
            return
        self.proposal = answer
        opened = self._controller.views.translation
        self._box.show_result(answer.refinement, "" if opened is None else opened.target.name)
        self.proposal_changed.emit()

    def _failed(self, ticket: int, error: object) -> None:
        if ticket == self._ticket and isinstance(error, BaseException):
            self.discard()
            self._controller.show_problem(error)

    def _cancelled(self, ticket: int) -> None:
        if ticket == self._ticket and self._begun is not None:
            self._begun = self.proposal = None
            self._box.show_idle("cancelled; nothing was changed")
