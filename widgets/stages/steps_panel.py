"""Steps panel: curves over the kept steps of a stage, why it stopped, and any step on display."""

from collections.abc import Mapping, Sequence

from PyQt6.QtCore import pyqtSignal
from PyQt6.QtWidgets import QLabel, QWidget

from pipeline.views.view import StepCurve, StepHistory
from widgets.style.base import ChoiceBox
from widgets.style.plots import Strip, StripPlot
from widgets.style.styling import make_button, make_column, make_row, make_text

_NOTHING = "Step through keeps the steps and shows them one by one; the result stays the same"
KEEP_STEPS = "Step through"
DISCARD_STEPS = "Discard steps"


def make_curve_strips(curves: Sequence[StepCurve]) -> list[Strip]:
    """Return a strip per curve."""
    titles = [f"{curve.name}, {curve.unit}" if curve.unit else curve.name for curve in curves]
    return [
        Strip(title=title, curves=(("", c.values),))
        for title, c in zip(titles, curves, strict=True)
    ]


class StepsPanel(QWidget):
    """Stage chooser, button that requests the steps, message, plot, and the current step as
    text.
    """

    keep_steps_requested = pyqtSignal(str, bool)

    def __init__(self) -> None:
        super().__init__()
        self.stage_box = ChoiceBox("steps_slot", "stage to step through")
        self.keep_button = make_button(KEEP_STEPS, "steps_keep")
        self.plot = StripPlot("steps_plot", "metrics of every step")
        # why it stopped, or what can be done
        self.message = make_text()
        self.step_text = QLabel()
        self._way: StepHistory | None = None
        self._kept = False
        self.message.setText(_NOTHING)
        head = make_row(8, self.stage_box, self.keep_button, (self.message, 1))
        make_column(2, head, (self.plot, 1), self.step_text, around_px=(6, 4, 6, 4), on=self)
        self.keep_button.clicked.connect(
            lambda: self.keep_steps_requested.emit(self.stage_box.choice, not self._kept)
        )

    def offer_stages(self, stages: Mapping[str, str]) -> None:
        """Offer name -> title of stages with steps; the last one unless another was chosen."""
        chosen = self.stage_box.choice
        self.stage_box.offer(stages, chosen if chosen in stages else ["", *stages][-1])

    def show_history(
        self,
        history: StepHistory | None,
        *,
        keeps_steps: bool,
        can_keep_steps: bool,
        why_not: str = "",
    ) -> None:
        """Show the step history of a stage, whether steps are kept now, and whether the method
        can keep them.
        """
        self._way = history
        self._kept = keeps_steps
        self.keep_button.setText(DISCARD_STEPS if keeps_steps else KEEP_STEPS)
        self.keep_button.setEnabled(can_keep_steps)
        self.message.setText(history.stop_reason if history is not None else why_not or _NOTHING)
        self.plot.show_strips(
            () if history is None else make_curve_strips(history.curves),
            turns=() if history is None else history.phase_starts,
        )
        self.show_step(-1 if history is None else len(history.descriptions) - 1)

    def show_step(self, at: int) -> None:
        """Mark a step and show its text."""
        self.plot.show_step(at)
        steps = () if self._way is None else self._way.descriptions
        self.step_text.setText(
            f"step {at + 1} of {len(steps)}: {steps[at]}" if 0 <= at < len(steps) else ""
        )
