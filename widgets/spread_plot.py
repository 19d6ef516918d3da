"""Reliability plot of a sampler: error against standard deviation; calibrated samplers lie on the diagonal."""

from collections.abc import Sequence
from itertools import pairwise

from PyQt6.QtCore import QPointF, QRectF, Qt
from PyQt6.QtGui import QPainter, QPalette, QPen

from widgets.fonts import resize_font
from widgets.painted_widget import FIXED, PaintedWidget
from widgets.theme import ThemeColours, to_qcolor

_LEFT_PX, _BELOW_PX, _ROOM_PX, _DOT_PX = 46.0, 34.0, 14.0, 4.0


class SpreadPlot(PaintedWidget):
    """Points (standard deviation, error) in mm, both axes from zero and of equal length, with the diagonal."""

    preferred_px = 280, 280

    def __init__(self) -> None:
        super().__init__("spread_plot", "error against standard deviation", FIXED)
        resize_font(self)
        self.points: tuple[tuple[float, float], ...] = ()
        self.setMinimumWidth(240)
        self.setToolTip(
            "Each point is a group of pixels with similar standard deviation: its mean, and the rms error of the mean"
        )

    def show_points(self, points: Sequence[tuple[float, float]]) -> None:
        """Show these points; the plot is hidden without any."""
        self.points = tuple(points)
        self.setVisible(bool(self.points))
        self.update()

    def paint(self, painter: QPainter, ink: ThemeColours) -> None:
        """Draw axes, diagonal and points."""
        if not self.points:
            return
        palette = self.palette()
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        most = 1.05 * max(max(point) for point in self.points) or 1.0
        side = min(self.width() - _LEFT_PX - _ROOM_PX, self.height() - _BELOW_PX - 2 * _ROOM_PX)
        left, low = _LEFT_PX, _ROOM_PX + side

        def to_screen(x: float, y: float) -> QPointF:
            return QPointF(left + side * x / most, low - side * y / most)

        painter.setPen(palette.color(QPalette.ColorRole.Mid))
        painter.drawRect(QRectF(left, _ROOM_PX, side, side))
        painter.setPen(QPen(palette.color(QPalette.ColorRole.Mid), 1, Qt.PenStyle.DashLine))
        painter.drawLine(to_screen(0, 0), to_screen(most, most))
        painter.setPen(palette.color(QPalette.ColorRole.WindowText))
        centre, right = Qt.AlignmentFlag.AlignHCenter, Qt.AlignmentFlag.AlignRight
        painter.drawText(QRectF(left, low + 2, side, 16), right, f"{most:.2g}")
        painter.drawText(QRectF(left, low + 16, side, 16), centre, "standard deviation, mm")
        painter.drawText(QRectF(0, _ROOM_PX - 4, left - 4, 16), right, f"{most:.2g}")
        painter.save()
        painter.translate(12, low)
        painter.rotate(-90)
        painter.drawText(QRectF(0, 0, side, 16), centre, "rms error of the mean, mm")
        painter.restore()
        dots = [to_screen(*point) for point in self.points]
        painter.setPen(QPen(to_qcolor(ink.accent), 1.5))
        for one, other in pairwise(dots):
            painter.drawLine(one, other)
        painter.setBrush(to_qcolor(ink.accent))
        for dot in dots:
            painter.drawEllipse(dot, _DOT_PX, _DOT_PX)
