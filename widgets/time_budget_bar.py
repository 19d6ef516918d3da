"""Time budget of a frame as one stacked bar, with a mark at the target."""

from __future__ import annotations

from dataclasses import dataclass

from PyQt6.QtCore import QRectF, Qt
from PyQt6.QtGui import QColor, QPainter, QPalette, QPen

from widgets.painted_widget import FIXED, PaintedWidget
from widgets.theme import CATEGORY_COLOURS, ThemeColours, to_qcolor

_BAR_PX, _MARK_PX = 18, 3
_LIGHT_LUMA = 140.0  # of 255: colours above it carry dark text


@dataclass(frozen=True, slots=True, kw_only=True)
class BudgetPart:
    """One segment of the bar."""

    title: str
    time_ms: float


class TimeBudgetBar(PaintedWidget):
    """Paints the parts of a frame's time one after the other; the mark is where the target rate ends."""

    preferred_px = 420, _BAR_PX + 2 * _MARK_PX

    def __init__(self) -> None:
        super().__init__("time_budget", "time budget of a frame", down=FIXED)
        self.parts: tuple[BudgetPart, ...] = ()
        self._target_ms = 0.0

    def show_parts(self, parts: tuple[BudgetPart, ...], target_ms: float) -> None:
        """Show these times, and the time that a frame has at the target rate."""
        self.parts, self._target_ms = parts, target_ms
        spoken = ", ".join(f"{part.title} {part.time_ms:.1f} ms" for part in parts)
        self.setToolTip(f"{spoken}; the mark is the target of {target_ms:.0f} ms" if parts else "")
        self.setAccessibleDescription(self.toolTip())
        self.update()

    def paint(self, painter: QPainter, ink: ThemeColours) -> None:
        """Paint the segments with their titles where there is room, then the mark."""
        del ink
        longest_ms = max(sum(part.time_ms for part in self.parts), self._target_ms)
        if not self.parts or longest_ms <= 0:
            return
        per_ms, left = (self.width() - 2) / longest_ms, 0.0
        for number, part in enumerate(self.parts):
            colour = to_qcolor(CATEGORY_COLOURS[number % len(CATEGORY_COLOURS)])
            box = QRectF(left, _MARK_PX, part.time_ms * per_ms, _BAR_PX)
            painter.fillRect(box, colour)
            if painter.fontMetrics().horizontalAdvance(part.title) + 8 < box.width():
                painter.setPen(_text_colour(colour))
                painter.drawText(box, Qt.AlignmentFlag.AlignCenter, part.title)
            left = box.right()
        painter.setPen(QPen(self.palette().color(QPalette.ColorRole.WindowText), 2))
        at = round(self._target_ms * per_ms)
        painter.drawLine(at, 0, at, self.height())


def _text_colour(background: QColor) -> QColor:
    luma = 0.299 * background.red() + 0.587 * background.green() + 0.114 * background.blue()
    return QColor(20, 24, 30) if luma > _LIGHT_LUMA else QColor(255, 255, 255)
