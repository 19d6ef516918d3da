"""Steps panel: curves over the kept steps of a stage, why it stopped, and any step on display."""

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

from PyQt6.QtCore import QPointF, QRectF, Qt, pyqtSignal
from PyQt6.QtGui import QPainter, QPalette, QPen
from PyQt6.QtWidgets import QHBoxLayout, QLabel, QPushButton, QVBoxLayout, QWidget

from pipeline.previews.view import StepCurve, StepHistory
from widgets.base import ChoiceBox, PaintedWidget, resize_font
from widgets.styling import fill, set_spacing
from widgets.theme import ThemeColours, get_theme_colours, to_qcolor

_RIGHT_PX, _GAP_PX, _DOT_PX = 14.0, 10.0, 2.5
_WIDEST_LIMIT, _BETWEEN_PX = "0.0000 mm", 8.0  # number at the upper end of a curve; space around names and numbers
_NOTHING = "Step through keeps the steps and shows them one by one; the result stays the same"
KEEP_STEPS, DISCARD_STEPS = "Step through", "Discard steps"


class StepsPlot(PaintedWidget):
    """One strip per curve over the same steps; click, drag or arrow keys choose a step."""

    step_chosen = pyqtSignal(int)

    preferred_px = 400, 130

    def __init__(self, name: str = "steps_plot", description: str = "metrics of every step") -> None:
        super().__init__(name, description)
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        resize_font(self)
        self._curves: tuple[StepCurve, ...] = ()
        self._left_px = 0.0  # room of names and numbers, left of the curves
        self._turns: tuple[int, ...] = ()
        self.current_step = -1

    def show_curves(self, curves: Sequence[StepCurve], turns: Sequence[int]) -> None:
        """Show these curves, with a line before each of the `turns`."""
        self._curves, self._turns = tuple(curves), tuple(turns)
        wide = self.fontMetrics().horizontalAdvance
        names_px = max((wide(curve.name) for curve in self._curves), default=0)
        self._left_px = names_px + wide(_WIDEST_LIMIT) + 3 * _BETWEEN_PX
        self.update()

    def show_step(self, at: int) -> None:
        """Mark a step."""
        if at != self.current_step:
            self.current_step = at
            self.update()

    @property
    def n_steps(self) -> int:
        """Number of steps."""
        return len(self._curves[0].values) if self._curves else 0

    def compute_step_x_px(self, at: int) -> float:
        """Return the horizontal position of a step."""
        wide = self.width() - self._left_px - _RIGHT_PX
        return self._left_px + wide * at / max(1, self.n_steps - 1)

    def paint(self, painter: QPainter, ink: ThemeColours) -> None:
        """Paint strips, marks and the current step."""
        if not self.n_steps:
            return
        palette = self.palette()
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        tall = (self.height() - _GAP_PX * (len(self._curves) + 1)) / len(self._curves)
        if 0 <= self.current_step < self.n_steps:
            painter.setPen(QPen(to_qcolor(ink.accent), 2))
            x = self.compute_step_x_px(self.current_step)
            painter.drawLine(QPointF(x, 0), QPointF(x, self.height()))
        painter.setPen(QPen(palette.color(QPalette.ColorRole.Mid), 1, Qt.PenStyle.DashLine))
        for turn in self._turns:
            x = 0.5 * (self.compute_step_x_px(turn - 1) + self.compute_step_x_px(turn))
            painter.drawLine(QPointF(x, 0), QPointF(x, self.height()))
        for k, curve in enumerate(self._curves):
            top = _GAP_PX + k * (tall + _GAP_PX)
            self._draw(painter, curve, QRectF(self._left_px, top, self.width() - self._left_px - _RIGHT_PX, tall))

    def _draw(self, painter: QPainter, curve: StepCurve, room: QRectF) -> None:
        palette = self.palette()
        known = [value for value in curve.values if math.isfinite(value)]
        most = max(known, default=0.0) or 1.0
        painter.setPen(palette.color(QPalette.ColorRole.Mid))
        painter.drawLine(room.bottomLeft(), room.bottomRight())
        painter.setPen(palette.color(QPalette.ColorRole.WindowText))
        words = QRectF(0.5 * _BETWEEN_PX, room.top() - 4, self._left_px - 1.5 * _BETWEEN_PX, room.height() + 8)
        right = Qt.AlignmentFlag.AlignRight
        painter.drawText(words, Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignVCenter, curve.name)
        painter.drawText(words, right | Qt.AlignmentFlag.AlignTop, f"{most:.3g} {curve.unit}")
        painter.drawText(words, right | Qt.AlignmentFlag.AlignBottom, "0")
        dots = [
            QPointF(self.compute_step_x_px(k), room.bottom() - room.height() * value / most)
            for k, value in enumerate(curve.values) if math.isfinite(value)
        ]  # fmt: skip
        ink = to_qcolor(get_theme_colours(palette).secondary_text)
        painter.setPen(QPen(ink, 1.5))
        for one, other in pairwise(dots):
            painter.drawLine(one, other)
        painter.setBrush(ink)
        for dot in dots:
            painter.drawEllipse(dot, _DOT_PX, _DOT_PX)

    def _choose(self, at: int) -> None:
        at = min(max(at, 0), self.n_steps - 1)
        if self.n_steps and at != self.current_step:
            self.step_chosen.emit(at)

    def mousePressEvent(self, a0: Any) -> None:  # noqa: N802
        """Choose the step at this position."""
        wide = max(1.0, self.width() - self._left_px - _RIGHT_PX)
        self._choose(round((a0.position().x() - self._left_px) / wide * max(1, self.n_steps - 1)))

    def mouseMoveEvent(self, a0: Any) -> None:  # noqa: N802
        """Choose steps while dragging."""
        self.mousePressEvent(a0)

    def keyPressEvent(self, a0: Any) -> None:  # noqa: N802
        """Choose the next, previous, first or last step."""
        ways = {Qt.Key.Key_Left: self.current_step - 1, Qt.Key.Key_Right: self.current_step + 1, Qt.Key.Key_Home: 0,
                Qt.Key.Key_End: self.n_steps - 1}  # fmt: skip
        if a0.key() in ways:
            self._choose(ways[a0.key()])
        else:
            super().keyPressEvent(a0)


class StepsPanel(QWidget):
    """Stage chooser, button that requests the steps, message, plot, and the current step as text."""

    keep_steps_requested = pyqtSignal(str, bool)

    def __init__(self) -> None:
        super().__init__()
        self.stage_box = ChoiceBox("steps_slot", "stage to step through")
        self.keep_button, self.plot = QPushButton(KEEP_STEPS), StepsPlot()
        self.message, self.step_text = QLabel(_NOTHING), QLabel()  # why it stopped, or what can be done
        self._way: StepHistory | None = None
        self._kept = False
        self.keep_button.setObjectName("steps_keep")
        self.message.setWordWrap(True)
        head = fill(set_spacing(QHBoxLayout(), 8), self.stage_box, self.keep_button, (self.message, 1))
        fill(set_spacing(QVBoxLayout(self), 2, (6, 4, 6, 4)), head, (self.plot, 1), self.step_text)
        self.keep_button.clicked.connect(lambda: self.keep_steps_requested.emit(self.stage_box.choice, not self._kept))

    def offer_stages(self, stages: Mapping[str, str]) -> None:
        """Offer name -> title of stages with steps; the last one unless another was chosen."""
        chosen = self.stage_box.choice
        self.stage_box.offer(stages, chosen if chosen in stages else ["", *stages][-1])

    def show_history(
        self, history: StepHistory | None, *, keeps_steps: bool, can_keep_steps: bool, why_not: str = ""
    ) -> None:
        """Show the step history of a stage, whether steps are kept now, and whether the method can keep them."""
        self._way, self._kept = history, keeps_steps
        self.keep_button.setText(DISCARD_STEPS if keeps_steps else KEEP_STEPS)
        self.keep_button.setEnabled(can_keep_steps)
        self.message.setText(history.stop_reason if history is not None else why_not or _NOTHING)
        self.plot.show_curves(
            () if history is None else history.curves, () if history is None else history.phase_starts
        )
        self.show_step(-1 if history is None else len(history.descriptions) - 1)

    def show_step(self, at: int) -> None:
        """Mark a step and show its text."""
        self.plot.show_step(at)
        steps = () if self._way is None else self._way.descriptions
        self.step_text.setText(f"step {at + 1} of {len(steps)}: {steps[at]}" if 0 <= at < len(steps) else "")
