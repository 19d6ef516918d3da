"""Refinement of the alignment, in the background.

Its result is a proposal that the user accepts or discards.
"""

from PyQt6.QtCore import pyqtSignal

from app.align import alignment_jobs
from app.align.alignment_jobs import RefinementProposal
from app.document.background_controller import BackgroundController
from app.document.requests import make_request
from app.document.session_controller import SessionController
from app.session.state import Session


class RefinementController(BackgroundController):
    """Connects the refinement box with the session.

    A proposal for another recording or alignment is dropped.
    """

    proposal_changed = pyqtSignal()

    def __init__(self, controller: SessionController) -> None:
        self._box = controller.window.alignment.refine
        super().__init__("refine", controller, self._box.run_bar)
        self._refined: Session | None = None
        self.proposal: RefinementProposal | None = None
        self._box.run_bar.start_button.clicked.connect(self.start_refinement)
        self._box.accept.clicked.connect(self.accept)
        self._box.discard.clicked.connect(self.discard)

    @property
    def is_refining(self) -> bool:
        """Whether a refinement is running."""
        return self._refined is not None and self.proposal is None

    def start_refinement(self) -> None:
        """Refine the alignment of the open recording."""
        session = self._session
        if self._translation is None:
            return
        self._refined = session
        self.proposal = None
        self._box.show_message("opening the recording")
        self.start(lambda report: alignment_jobs.propose_refinement(session, report))

    def accept(self) -> None:
        """Set the proposed offsets as one undo step."""
        proposal = self.proposal
        self.discard()
        if proposal is not None:
            self._change("refine alignment", offsets=proposal.offsets)

    def discard(self) -> None:
        """Drop the proposal, or the running refinement."""
        had_proposal = self.proposal is not None
        self._refined = None
        self.proposal = None
        self.abandon()
        self._box.show_message()
        if had_proposal:
            self.proposal_changed.emit()

    def show_session(self) -> None:
        """Drop a proposal for another recording or alignment."""
        if self._refined is not None and make_request(self._session) != make_request(self._refined):
            self.discard()

    def show_progress(self, fraction: float, text: str) -> None:
        """Show the progress in the box."""
        super().show_progress(fraction, text)
        self._box.show_message(text)

    def show_result(self, result: object) -> None:
        """Show the proposal in the box."""
        if isinstance(result, RefinementProposal):
            self.proposal = result
            opened = self._translation
            self._box.show_result(result.refinement, "" if opened is None else opened.target.name)
            self.proposal_changed.emit()

    def show_failure(self, error: BaseException) -> None:  # noqa: ARG002 - the banner shows it
        """Drop the refinement."""
        self.discard()

    def show_cancelled(self) -> None:
        """Show in the box that the alignment is unchanged."""
        self._refined = None
        self._box.show_message("cancelled; alignment unchanged")
