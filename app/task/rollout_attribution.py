"""Error attribution in the *Task* layout: stored shares at once, others by running the rollout
again when asked.
"""

from functools import partial
from pathlib import Path

from app.document.background_controller import BackgroundController
from app.document.session_controller import SessionController
from app.task.rollout_jobs import attribute_decisions
from app.task.rollouts import RolloutController
from pipeline.lab.tasks.task import Decision, describe_error


class RolloutAttributionController(BackgroundController):
    """Connects the decision's panel with the rollout on screen."""

    shows_errors = True

    def __init__(self, controller: SessionController, rollouts: RolloutController) -> None:
        super().__init__("rollout attribution", controller, controller.window.task.decision.run_bar)
        self._rollouts = rollouts
        self._panel = controller.window.task.decision
        self._results: dict[Path, tuple[Decision, ...]] = {}  # computed in this window
        self._running: Path | None = None
        self._panel.run_bar.start_button.clicked.connect(self.attribute)
        rollouts.rollout_shown.connect(self._show_rollout)
        rollouts.decision_shown.connect(self._show_decision)
        controller.window.connect_command("attribute_rollout", self.attribute)
        controller.window.connect_command("cancel", self.cancel)
        self._show_decision()

    def attribute(self) -> None:
        """Run the rollout on screen again with the truth in place of one stage after the other."""
        opened = self._rollouts.shown
        if opened is None or not self._can_attribute or self.job.is_busy:
            return
        self._running = opened.rollout.path
        self.start(partial(attribute_decisions, opened.rollout))

    @property
    def decisions(self) -> tuple[Decision, ...]:
        """The decisions of the rollout on screen, with shares where they are known."""
        opened = self._rollouts.shown
        if opened is None:
            return ()
        return self._results.get(opened.rollout.path, opened.rollout.summary.decisions)

    @property
    def _can_attribute(self) -> bool:
        opened = self._rollouts.shown
        known = any(decision.shares for decision in self.decisions)
        return opened is not None and not opened.rollout.summary.succeeds and not known

    def _show_rollout(self) -> None:
        opened = self._rollouts.shown
        if opened is None or opened.rollout.path != self._running:
            self.abandon()
        self._show_decision()

    def _show_decision(self, _: int = 0) -> None:
        """Show the decision at the tick on screen, or else the one whose error is attributed."""
        opened = self._rollouts.shown
        decisions = self.decisions
        can = self._can_attribute
        self._actions["attribute_rollout"].setEnabled(can)
        if self.job.is_busy and self._running is not None:
            return
        if opened is None or not decisions:
            self._panel.show_decision("", None, can_attribute=False)
            return
        current = decisions[min(self._rollouts.decision, len(decisions) - 1)]
        shown = (
            current if current.shares else next((one for one in decisions if one.shares), current)
        )
        succeeds = opened.rollout.summary.succeeds
        sentence = describe_error(shown, opened.error_title, succeeds=succeeds)
        if shown is not current and not succeeds:
            sentence = f"at tick {shown.tick} {sentence}"
        self._panel.show_decision(sentence, shown, can_attribute=can)

    def show_progress(self, fraction: float, text: str) -> None:
        """Show how far the run is, and what it does."""
        super().show_progress(fraction, text)
        self._panel.sentence.setText(text)

    def show_result(self, result: object) -> None:
        """Keep and show the shares."""
        if isinstance(result, tuple) and self._running is not None:
            self._results[self._running] = result
        self._end()

    def show_failure(self, error: BaseException) -> None:
        """Show why there are no shares."""
        self._end()
        self._panel.show_decision(str(error), None, can_attribute=self._can_attribute)

    def show_cancelled(self) -> None:
        """Show the decision again."""
        self._end()

    def _end(self) -> None:
        self._running = None
        self._show_decision()
