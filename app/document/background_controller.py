"""Base of controllers that run one long function in the background: progress, parts, result,
failure, cancellation.
"""

from app.document.feature import Feature
from app.document.session_controller import SessionController
from app.window.jobs import JobFunction, LatestJob
from pipeline.core.errors import TouchError
from widgets.style.run_bar import RunBar


class BackgroundController(Feature):
    """Runs one function at a time on its own thread.

    Subclasses override the `show_` methods they need.

    Only the newest run is shown. A run that was not interrupted by the next one still shows its
    result. `bar` shows the progress and cancels.
    """

    # whether `show_failure` shows a TouchError where the user looks; others are in the banner
    shows_errors = False

    def __init__(self, name: str, controller: SessionController, *bars: RunBar) -> None:
        super().__init__(controller)
        self._bars = bars
        self.job = LatestJob(name, self)
        # the newest run, and the oldest whose result is shown; 0 = none
        self._ticket = self._oldest_shown = 0
        self.job.progressed.connect(self._handle_progress)
        self.job.delivered.connect(self._handle_part)
        self.job.finished.connect(self._handle_result)
        self.job.failed.connect(self._handle_failure)
        self.job.cancelled.connect(self._handle_cancellation)
        for bar in bars:
            bar.cancel_button.clicked.connect(self.cancel)

    def close(self) -> None:
        """End the thread."""
        self.job.close()

    @property
    def is_busy(self) -> bool:
        """Whether a run has not ended yet."""
        return not self.job.is_settled

    def start(self, work: JobFunction, *, interrupt: bool = True) -> None:
        """Run `work`; without `interrupt` the run before it finishes first, and shows its
        result.
        """
        self._ticket = 0  # the end of the run before it is not that of this one
        self._ticket = self.job.submit(work, interrupt=interrupt)
        if interrupt or not self._oldest_shown:
            self._oldest_shown = self._ticket
        self._show_fraction(0.0)

    def cancel(self) -> None:
        """Cancel the run; `show_cancelled` follows."""
        self.job.cancel()

    def abandon(self) -> None:
        """Cancel the run, and show nothing more of it."""
        self._ticket = self._oldest_shown = 0
        self.job.cancel()
        self._show_fraction(None)

    def _show_fraction(self, fraction: float | None) -> None:
        for bar in self._bars:
            bar.show_progress(fraction)

    def show_progress(self, fraction: float, text: str) -> None:  # noqa: ARG002 - for those with room for a text
        """Show how far the run is, by default in the bar alone."""
        self._show_fraction(fraction)

    def show_part(self, part: object) -> None:
        """Show a part of the result."""

    def show_result(self, result: object) -> None:
        """Show the result."""

    def show_failure(self, error: BaseException) -> None:
        """Show that the run failed."""

    def show_cancelled(self) -> None:
        """Show that the run was cancelled."""

    def _handle_progress(self, ticket: int, fraction: float, text: str) -> None:
        if ticket == self._ticket and self.job.is_busy:
            self.show_progress(fraction, text)

    def _handle_part(self, ticket: int, part: object) -> None:
        if ticket == self._ticket:
            self.show_part(part)

    def _handle_result(self, ticket: int, result: object) -> None:
        if not self.job.is_busy:
            self._show_fraction(None)
        if self._oldest_shown and ticket >= self._oldest_shown:
            self.show_result(result)

    def _handle_failure(self, ticket: int, error: object) -> None:
        if ticket == self._ticket and isinstance(error, BaseException):
            self._show_fraction(None)
            self.show_failure(error)
            if not (self.shows_errors and isinstance(error, TouchError)):
                self._controller.show_problem(error)

    def _handle_cancellation(self, ticket: int) -> None:
        if ticket == self._ticket:
            self._show_fraction(None)
            self.show_cancelled()
