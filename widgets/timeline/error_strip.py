"""Every frame as a thumbnail under its value: errors as bars, quantities as a curve; and marks for
warnings.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from PyQt6.QtCore import QPointF, QRectF, QSize, Qt, pyqtSignal
from PyQt6.QtGui import QHelpEvent, QPainter, QPen, QPixmap, QPolygonF
from PyQt6.QtWidgets import QSizePolicy, QToolTip

from widgets.style.base import YIELDS, PaintedWidget
from widgets.style.theme import ThemeColours, to_qcolor

_MARK_PX = 7.0
_WIDEST_PX = 48.0
_IMAGE_PX = 42
_HEIGHT_PX = 78
_LEAST_PX = 24  # minimum height
_CURVE_PX = 1.8
# of the highest bar, from the top; of all bars, from the bottom
_TOP_PX = _MARK_PX + 2.0
_BASE_PX = 2.0
_TICK_PX = 3.0  # length of a tick


class ErrorStrip(PaintedWidget):
    """One thumbnail and bar per frame or a curve, a mark for warnings; `frame_chosen` by click and
    drag.
    """

    frame_chosen = pyqtSignal(int)
    preferred_px = 200, _HEIGHT_PX  # bars over thumbnails

    def __init__(self) -> None:
        super().__init__("error_strip", "error of every frame", down=QSizePolicy.Policy.Maximum)
        self.values: tuple[float, ...] = ()  # NaN = unknown
        self.is_curve = False
        self.warnings: Mapping[int, Sequence[str]] = {}
        self.loop_range: tuple[int, int] | None = None  # range of a looped playback
        self.frame = 0
        self._unit = ""
        self.thumbnails: Mapping[int, QPixmap] = {}

    @property
    def worst_frame(self) -> int:
        """The frame with the largest value; -1 while none is known."""
        known = [i for i, value in enumerate(self.values) if math.isfinite(value)]
        return max(known, key=self.values.__getitem__, default=-1)

    @property
    def max_value(self) -> float:
        """The value of the highest bar; 0 while none is known."""
        return max((value for value in self.values if math.isfinite(value)), default=0.0)

    def show_values(
        self,
        values: Sequence[float],
        unit: str,
        warnings: Mapping[int, Sequence[str]],
        *,
        is_curve: bool = False,
    ) -> None:
        """Show a value for every frame (NaN = unknown), as bars or as a curve, and the warnings
        of each.
        """
        self.values = tuple(values)
        self._unit = unit
        self.warnings = warnings
        self.is_curve = is_curve
        self.update()

    def show_frame(self, frame: int) -> None:
        """Mark the current frame."""
        self.frame = frame
        self.update()

    def show_loop_range(self, span: tuple[int, int] | None) -> None:
        """Mark the loop range; None for all frames."""
        self.loop_range = span
        self.update()

    def show_thumbnails(self, thumbnails: Mapping[int, QPixmap]) -> None:
        """Show frame -> image of the frames that have one."""
        self.thumbnails = thumbnails
        self.update()

    def minimumSizeHint(self) -> QSize:  # noqa: N802
        """Return a height that fits small screens."""
        return QSize(60, _LEAST_PX)

    def describe_frame(self, frame: int) -> str:
        """Return what is known of a frame as a sentence."""
        if not 0 <= frame < len(self.values):
            return ""
        value = self.values[frame]
        text = f"{value:.3g} {self._unit}" if math.isfinite(value) else "value unknown"
        return "\n".join((f"frame {frame}: {text}", *self.warnings.get(frame, ())))

    def frame_at(self, x: float) -> int:
        """Return the frame at a horizontal position."""
        n = len(self.values)
        return max(0, min(int(x / self.width() * n), n - 1))

    def paint(self, painter: QPainter, ink: ThemeColours) -> None:
        """Paint bars on one line and marks above them."""
        n = len(self.values)
        if not n:
            return
        painter.setRenderHint(QPainter.RenderHint.Antialiasing, n < 200)
        palette = self.palette()
        has_images = bool(self.thumbnails) and self.height() >= _IMAGE_PX + _LEAST_PX
        base = self.height() - _BASE_PX - (_IMAGE_PX if has_images else 0)
        step = self.width() / n
        wide = max(1.5, min(0.7 * step, _WIDEST_PX))
        painter.fillRect(QRectF(self.frame * step, 0, step, self.height()), palette.midlight())
        if has_images:
            self._draw_images(painter, step, base)
        painter.setPen(QPen(palette.mid(), 1))
        painter.drawLine(QPointF(0, base), QPointF(self.width(), base))
        if self.loop_range is not None:
            ends = [QPointF((frame + 0.5) * step, base) for frame in self.loop_range]
            painter.setPen(QPen(palette.highlight(), 2.5))
            painter.drawLine(*ends)
            for end in ends:
                painter.drawLine(end, end - QPointF(0.0, 6.0))
        worst = self.worst_frame
        per_unit = (base - _TOP_PX) / max(self.max_value, 1e-12)
        tops = [
            QPointF((frame + 0.5) * step, base - max(1.5, value * per_unit))
            for frame, value in enumerate(self.values)
        ]
        known = {frame for frame, value in enumerate(self.values) if math.isfinite(value)}
        painter.setPen(QPen(to_qcolor(ink.accent), _CURVE_PX))
        for frame in known if self.max_value > 0 else ():
            if self.is_curve:
                painter.drawLine(tops[frame - 1 if frame - 1 in known else frame], tops[frame])
            else:
                bar = QRectF(tops[frame].x() - 0.5 * wide, tops[frame].y(), wide, 0.0)
                bar.setBottom(base)
                painter.fillRect(bar, to_qcolor(ink.worse if frame == worst else ink.accent))
        painter.setPen(Qt.PenStyle.NoPen)
        painter.setBrush(to_qcolor(ink.warning_mark))
        for frame in self.warnings.keys() & range(n):
            mark = QRectF(tops[frame].x() - 0.5 * _MARK_PX, 0, _MARK_PX, _MARK_PX)
            below = QPointF(tops[frame].x(), mark.bottom())
            painter.drawPolygon(QPolygonF([mark.topLeft(), mark.topRight(), below]))

    def _draw_images(self, painter: QPainter, step: float, base: float) -> None:
        """Paint the thumbnails that fit beside each other, those of other frames not."""
        end = 0.0
        for frame in sorted(self.thumbnails):
            image = self.thumbnails[frame]
            wide = image.width() * min(1.0, (_IMAGE_PX - 2) / max(1, image.height()))
            left = (frame + 0.5) * step - 0.5 * wide
            if left >= end:
                room = QRectF(left, base + 2, wide, _IMAGE_PX - 2)
                painter.drawPixmap(room, image, QRectF(image.rect()))
                end = left + wide + 1

    def mousePressEvent(self, a0: Any) -> None:  # noqa: N802
        """Choose the frame under the mouse."""
        self._choose(a0)

    def mouseMoveEvent(self, a0: Any) -> None:  # noqa: N802
        """Choose frames while dragging."""
        self._choose(a0)

    def event(self, a0: Any) -> bool:
        """Show a tooltip for the frame under the mouse."""
        if isinstance(a0, QHelpEvent):
            text = self.describe_frame(self.frame_at(a0.pos().x()))
            QToolTip.showText(a0.globalPos(), text, self)
            return True
        return super().event(a0)

    def _choose(self, event: Any) -> None:
        if self.values and event.buttons() & Qt.MouseButton.LeftButton:
            self.frame_chosen.emit(self.frame_at(event.position().x()))


class ErrorScale(PaintedWidget):
    """Scale of the bars: the largest value and 0, with the unit."""

    def __init__(self) -> None:
        super().__init__("error_scale", down=YIELDS)
        self.setFixedWidth(self.fontMetrics().horizontalAdvance("0.0000") + round(_TICK_PX) + 2)
        self.max_text = ""  # label at the upper end

    def show_max(self, most: float) -> None:
        """Show the value of the highest bar; nothing if there are no bars."""
        self.max_text = f"{most:.3g}" if most > 0 else ""
        self.update()

    def paint(self, painter: QPainter, ink: ThemeColours) -> None:
        """Paint two numbers at two ticks on a line."""
        del ink
        if not self.max_text:
            return
        right = self.width() - 1.0
        base = self.height() - _BASE_PX
        metrics = painter.fontMetrics()
        painter.setPen(QPen(self.palette().mid(), 1))
        painter.drawLine(QPointF(right, _TOP_PX), QPointF(right, base))
        painter.setPen(self.palette().windowText().color())
        for text, y in ((self.max_text, _TOP_PX), ("0", base)):
            end = QPointF(right - _TICK_PX, y)
            painter.drawLine(end, QPointF(right, y))
            end.setY(min(y + 0.4 * metrics.ascent(), self.height() - 1.0))
            painter.drawText(end - QPointF(metrics.horizontalAdvance(text) + 2.0, 0.0), text)
