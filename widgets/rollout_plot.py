"""Plot of a rollout against time: one strip per quantity, one cursor, and a mark at every decision."""

from collections.abc import Sequence

from PyQt6.QtCore import QPointF, QRectF, Qt
from PyQt6.QtGui import QPainter, QPalette, QPolygonF

from pipeline.stages.stage import StepCurve
from widgets.steps_panel import StepsPlot
from widgets.theme import ThemeColours, to_qcolor

_MARK_PX = 4.0
_LAST_TIMES = 3  # times written under the plot: first, middle and last


class RolloutPlot(StepsPlot):
    """Click, drag or arrow keys choose a tick; triangles at the top mark decisions, times stand at the bottom."""

    def __init__(self) -> None:
        super().__init__("rollout_plot", "force and motion against time")
        self._times_s: Sequence[float] = ()
        self.decision_ticks: tuple[int, ...] = ()
        self.setMinimumHeight(90)

    def show_rollout(self, curves: Sequence[StepCurve], times_s: Sequence[float], decisions: Sequence[int]) -> None:
        """Show these curves over the times, with marks at the ticks of decisions."""
        self._times_s, self.decision_ticks = times_s, tuple(decisions)
        self.show_curves(curves, ())

    def paint(self, painter: QPainter, ink: ThemeColours) -> None:
        """Paint strips, marks of decisions, and times."""
        super().paint(painter, ink)
        if not self.n_steps:
            return
        painter.setPen(Qt.PenStyle.NoPen)
        painter.setBrush(to_qcolor(ink.worse))
        for tick in self.decision_ticks:
            x = self.compute_step_x_px(tick)
            corners = (QPointF(x - _MARK_PX, 0), QPointF(x + _MARK_PX, 0), QPointF(x, 1.7 * _MARK_PX))
            painter.drawPolygon(QPolygonF(corners))
        painter.setPen(self.palette().color(QPalette.ColorRole.PlaceholderText))
        height = self.fontMetrics().height()
        for k in range(_LAST_TIMES):
            tick = round(k * (self.n_steps - 1) / (_LAST_TIMES - 1))
            x = self.compute_step_x_px(tick)
            room = QRectF(x - (90 if k == _LAST_TIMES - 1 else 0 if k == 0 else 45), self.height() - height, 90, height)
            align = (Qt.AlignmentFlag.AlignLeft, Qt.AlignmentFlag.AlignHCenter, Qt.AlignmentFlag.AlignRight)[k]
            painter.drawText(room, align, f"{self._times_s[tick]:.2f} s")
