"""Histogram of the frames' metric: a drag over it chooses a range, a click clears it."""

import math
from collections.abc import Sequence

import numpy as np
from PyQt6.QtCore import QRectF, Qt, pyqtSignal
from PyQt6.QtGui import QMouseEvent, QPainter, QPalette

from widgets.style.base import FIXED, YIELDS, PaintedWidget
from widgets.style.theme import ThemeColours, to_qcolor

N_BARS = 24
# height of the bars; distance that makes a press a drag
_BARS_PX = 30
_DRAG_PX = 4
WHOLE = (-math.inf, math.inf)


class MetricHistogram(PaintedWidget):
    """Numbers of frames by the value of a metric.

    `range_chosen` carries the ends of a range, infinite for all.
    """

    range_chosen = pyqtSignal(float, float)

    def __init__(self) -> None:
        super().__init__("metric_histogram", "histogram of the metric", YIELDS, FIXED)
        self.counts: tuple[int, ...] = ()
        self._low = 0.0
        self._high = 1.0
        self._range = WHOLE
        self._pressed_px: float | None = None
        # bars, and one line of numbers
        self.preferred_px = 120, _BARS_PX + self.fontMetrics().height() + 2
        self.setToolTip(
            "Frames by the metric; drag over a range to list its frames, click to list all"
        )
        self.setCursor(Qt.CursorShape.IBeamCursor)
        self.hide()

    def show_values(self, values: Sequence[float], chosen: tuple[float, float] = WHOLE) -> None:
        """Show these values, NaN left out, and the chosen range; hidden while all are the same."""
        known = np.array([value for value in values if math.isfinite(value)])
        several = known.size > 1 and float(known.min()) < float(known.max())
        counts, edges = (
            np.histogram(known, N_BARS) if several else (np.zeros(0, int), np.array([0.0, 1.0]))
        )
        self.counts = tuple(int(count) for count in counts)
        self._low = float(edges[0])
        self._high = float(edges[-1])
        self._range = chosen
        self.setVisible(several)
        self.update()

    def mousePressEvent(self, a0: QMouseEvent | None) -> None:  # noqa: N802
        """Begin a range."""
        if a0 is not None and a0.button() == Qt.MouseButton.LeftButton:
            self._pressed_px = a0.position().x()

    def mouseMoveEvent(self, a0: QMouseEvent | None) -> None:  # noqa: N802
        """Choose the range from where the drag began to here."""
        if (
            a0 is None
            or self._pressed_px is None
            or abs(a0.position().x() - self._pressed_px) < _DRAG_PX
        ):
            return
        begin_px, end_px = sorted((self._pressed_px, a0.position().x()))
        low = self._to_value(begin_px) if begin_px > 0 else -math.inf
        high = self._to_value(end_px) if end_px < self.width() else math.inf
        if (low, high) != self._range:
            self._range = low, high
            self.update()
            self.range_chosen.emit(low, high)

    def mouseReleaseEvent(self, a0: QMouseEvent | None) -> None:  # noqa: N802
        """End the range; a click clears it."""
        if a0 is None or self._pressed_px is None:
            return
        if abs(a0.position().x() - self._pressed_px) < _DRAG_PX and self._range != WHOLE:
            self.range_chosen.emit(*WHOLE)
        self._pressed_px = None

    def paint(self, painter: QPainter, ink: ThemeColours) -> None:
        """Draw the bars, those of the range in the accent, and both ends of the values."""
        most = max((*self.counts, 1))
        width = self.width() / max(len(self.counts), 1)
        step = (self._high - self._low) / max(len(self.counts), 1)
        for k, count in enumerate(self.counts):
            tall = max(1.0, _BARS_PX * count / most) if count else 0.0
            inside = (
                self._range[0] < self._low + (k + 1) * step
                and self._low + k * step < self._range[1]
            )
            bar = QRectF(k * width, _BARS_PX - tall, max(width - 1.0, 1.0), tall)
            painter.fillRect(bar, to_qcolor(ink.accent if inside else ink.neutral))
        painter.setPen(self.palette().color(QPalette.ColorRole.Mid))
        painter.drawLine(0, _BARS_PX, self.width(), _BARS_PX)
        painter.setPen(to_qcolor(ink.secondary_text))
        words = QRectF(0, _BARS_PX + 1, self.width(), self.fontMetrics().height())
        painter.drawText(words, Qt.AlignmentFlag.AlignLeft, f"{self._low:.3g}")
        painter.drawText(words, Qt.AlignmentFlag.AlignRight, f"{self._high:.3g}")

    def _to_value(self, x_px: float) -> float:
        return self._low + (self._high - self._low) * x_px / max(self.width(), 1)
