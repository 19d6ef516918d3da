"""One metric as a bar with fixed limits, and a tick at its value before a drag."""

import math

from PyQt6.QtCore import QPointF, QRectF, Qt
from PyQt6.QtGui import QPainter, QPen, QPolygonF

from pipeline.core.frozen import frozen
from widgets.style.base import FIXED, PaintedWidget
from widgets.style.theme import ThemeColours, to_qcolor

_BAR_PX = 9
_TICK = (-3, -4), (3, -4), (0, 0)  # corners over a bar
_RIGHT = Qt.AlignmentFlag.AlignVCenter | Qt.AlignmentFlag.AlignRight


@frozen
class GaugeScale:
    """Range and unit of a gauge; the limits are absolute."""

    name: str
    unit: str  # "" for a share
    full_value: float  # the bar is full at this value and beyond
    digits: int
    higher_is_better: bool
    help: str


class Gauge(PaintedWidget):
    """Name, bar from 0 to the full value, number with unit, and ghost tick."""

    def __init__(self, scale: GaugeScale) -> None:
        super().__init__("gauge", scale.name, down=FIXED)
        self._scale = scale
        self.value: float | None = None  # None = no value
        self.ghost: float | None = None  # position of the ghost tick
        self.preferred_px = 180, self.fontMetrics().height() + 4  # one line
        better = "higher is better" if scale.higher_is_better else "lower is better"
        self.setToolTip(
            f"{scale.help}; {better}; the bar is full at {scale.full_value:g}{self._unit()}; "
            f"the tick marks the value before the last drag"
        )

    @property
    def text(self) -> str:
        """The value with its unit."""
        known = self.value is not None and math.isfinite(self.value)
        return f"{self.value:.{self._scale.digits}f}{self._unit()}" if known else "-"

    def show_value(self, value: float | None) -> None:
        """Show a value; None for none."""
        self.value = value
        self.setAccessibleDescription(self.text)
        self.update()

    def show_scale(self, scale: GaugeScale) -> None:
        """Change the limits."""
        self._scale = scale
        self.update()

    def mark_ghost(self, value: float | None) -> None:
        """Set the ghost tick; None removes it."""
        self.ghost = value
        self.update()

    def paint(self, painter: QPainter, ink: ThemeColours) -> None:
        """Paint name, bar, tick and number."""
        wide = self.fontMetrics().horizontalAdvance
        room = QRectF(self.rect())
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        painter.setPen(self.palette().text().color())
        painter.drawText(room, Qt.AlignmentFlag.AlignVCenter, self._scale.name)
        painter.drawText(room, _RIGHT, self.text)
        left, right = wide("mask IoU") + 8, wide("00.000 mm") + 6
        long_px = max(10.0, self.width() - left - right)
        bar = QRectF(left, (self.height() - _BAR_PX) / 2, long_px, _BAR_PX)
        painter.setPen(Qt.PenStyle.NoPen)
        painter.setBrush(to_qcolor(ink.gauge_background))
        painter.drawRoundedRect(bar, 2, 2)
        if self.value is not None and math.isfinite(self.value):
            bar.setWidth(long_px * self._share(self.value))
            painter.setBrush(to_qcolor(ink.gauge))
            painter.drawRoundedRect(bar, 2, 2)
        if self.ghost is not None and math.isfinite(self.ghost):
            tip = QPointF(left + long_px * self._share(self.ghost), bar.top())
            painter.setPen(QPen(to_qcolor(ink.ghost), 1.6))
            painter.drawLine(tip - QPointF(0, 2), tip + QPointF(0, _BAR_PX + 2))
            painter.setPen(Qt.PenStyle.NoPen)
            painter.setBrush(to_qcolor(ink.ghost))
            painter.drawPolygon(QPolygonF([tip + QPointF(*corner) for corner in _TICK]))

    def _share(self, value: float) -> float:
        return min(max(value / self._scale.full_value, 0.0), 1.0)

    def _unit(self) -> str:
        return f" {self._scale.unit}" if self._scale.unit else ""
