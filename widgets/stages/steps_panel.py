"""Steps panel: curves over the kept steps of a stage, why it stopped, and the step on display."""

from collections.abc import Sequence

from PyQt6.QtWidgets import QLabel, QVBoxLayout, QWidget

from pipeline.views.view import StepCurve, StepHistory
from widgets.style.plots import Strip, StripPlot
from widgets.style.styling import fill, set_spacing


def make_curve_strips(curves: Sequence[StepCurve]) -> list[Strip]:
    """Return a strip per curve."""
    titles = [f"{curve.name}, {curve.unit}" if curve.unit else curve.name for curve in curves]
    return [
        Strip(title=title, curves=(("", c.values),))
        for title, c in zip(titles, curves, strict=True)
    ]


class StepsPanel(QWidget):
    """Message, plot, and the current step as text."""

    def __init__(self) -> None:
        super().__init__()
        self.plot = StripPlot("steps_plot", "metrics of every step")
        self.message = QLabel()  # why it stopped, or what can be done
        self.message.setWordWrap(True)
        self.step_text = QLabel()
        self._steps: Sequence[str] = ()
        layout = set_spacing(QVBoxLayout(self), 2, (6, 4, 6, 4))
        fill(layout, self.message, (self.plot, 1), self.step_text)

    def show_history(self, title: str, history: StepHistory | None, why_not: str = "") -> None:
        """Show the step history of a stage, or why there is none."""
        self._steps = () if history is None else history.descriptions
        reason = why_not if history is None else history.stop_reason
        self.message.setText(f"{title}: {reason}")
        self.plot.show_strips(
            () if history is None else make_curve_strips(history.curves),
            turns=() if history is None else history.phase_starts,
        )
        self.show_step(len(self._steps) - 1)

    def show_step(self, at: int) -> None:
        """Mark a step and show its text."""
        self.plot.show_step(at)
        known = 0 <= at < len(self._steps)
        self.step_text.setText(
            f"step {at + 1} of {len(self._steps)}: {self._steps[at]}" if known else ""
        )
