"""Gizmo over an image: arrows translate along x and y, the centre translates freely, the ring
rotates.
"""

import math
from typing import Any, Literal

from PyQt6.QtCore import QEvent, QObject, QPointF, QRectF, Qt, pyqtSignal
from PyQt6.QtGui import QColor, QMouseEvent, QPainter, QPen, QPolygonF
from PyQt6.QtWidgets import QWidget

from pipeline.views.colours import Rgb
from widgets.style.theme import get_theme_colours, to_qcolor
from widgets.views.canvas import Canvas

GizmoPart = Literal["x", "y", "xy", "rz"]
_ARROW_PX = 46.0
_RING_PX = 66.0
_MIDDLE_PX = 8.0
_NEAR_PX = 7.0
_TIP_PX = 7.0


class Gizmo(QWidget):
    """Lives in a canvas; its parts take a drag before the canvas pans."""

    grabbed = pyqtSignal()
    # part, translation x and y in image pixels, rotation in degrees
    dragged = pyqtSignal(str, float, float, float)
    released = pyqtSignal()

    def __init__(self, canvas: Canvas) -> None:
        super().__init__(canvas)
        self.setObjectName("gizmo")
        # the canvas' events are filtered instead
        self.setAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)
        self._canvas = canvas
        self._at: QPointF | None = None  # image pixel
        self._held: tuple[GizmoPart, QPointF, QPointF] | None = (
            None  # part, press position and centre at that time, on the screen
        )
        self._under: GizmoPart | None = None
        canvas.installEventFilter(self)
        self.hide()

    @property
    def is_dragging(self) -> bool:
        """Whether a part is being dragged."""
        return self._held is not None

    def show_at(self, pixel: QPointF | None) -> None:
        """Put the centre on an image pixel; None hides the gizmo."""
        self._at = pixel
        self.setGeometry(self._canvas.rect())
        self.setVisible(pixel is not None)
        if pixel is None:
            self._held = self._under = None
        self.update()

    def part_at(self, at: QPointF) -> GizmoPart | None:
        """Return the part at a position of the canvas."""
        if self._at is None:
            return None
        off = at - self._canvas.to_screen(self._at)
        x = off.x()
        y = off.y()
        far = math.hypot(off.x(), off.y())
        if max(abs(x), abs(y)) <= _MIDDLE_PX:
            return "xy"
        if abs(y) < _NEAR_PX and 0 < x <= _ARROW_PX + _TIP_PX:
            return "x"
        if abs(x) < _NEAR_PX and 0 < y <= _ARROW_PX + _TIP_PX:
            return "y"
        return "rz" if abs(far - _RING_PX) < _NEAR_PX else None

    def eventFilter(self, a0: QObject | None, a1: QEvent | None) -> bool:  # noqa: N802
        """Handle the drags of its parts."""
        if a1 is not None and a1.type() == QEvent.Type.Resize:
            self.setGeometry(self._canvas.rect())
        if self.isHidden() or not isinstance(a1, QMouseEvent):
            return super().eventFilter(a0, a1)
        kind = a1.type()
        left = Qt.MouseButton.LeftButton
        if kind == QEvent.Type.MouseButtonPress and a1.button() == left:
            part = self.part_at(a1.position())
            if part is not None and self._at is not None:
                self._held = (part, a1.position(), self._canvas.to_screen(self._at))
                self.grabbed.emit()
                return True
        if kind == QEvent.Type.MouseButtonRelease and self._held is not None:
            self._held = None
            self.released.emit()
            self.update()
            return True
        if kind == QEvent.Type.MouseMove:
            if self._held is not None:
                self._drag(*self._held, a1.position())
                return True
            self._point(self.part_at(a1.position()))
            return self._under is not None
        return super().eventFilter(a0, a1)

    def _point(self, part: GizmoPart | None) -> None:
        if part != self._under:
            self._under = part
            shapes = Qt.CursorShape
            self._canvas.setCursor(shapes.ArrowCursor if part is None else shapes.OpenHandCursor)
            self.update()

    def _drag(self, part: GizmoPart, pressed: QPointF, middle: QPointF, at: QPointF) -> None:
        off = (at - pressed) / max(self._canvas.scale, 1e-6)
        x = off.x() if part != "y" else 0.0
        y = off.y() if part != "x" else 0.0
        if part != "rz":
            self.dragged.emit(part, x, y, 0.0)
            return
        begun, now = (math.atan2(p.y() - middle.y(), p.x() - middle.x()) for p in (pressed, at))
        turned = math.degrees(now - begun)
        self.dragged.emit(part, 0.0, 0.0, (turned + 180.0) % 360.0 - 180.0)

    def paintEvent(self, a0: Any) -> None:  # noqa: N802
        """Paint ring, arrows and centre with a casing that is visible on any image."""
        del a0
        if self._at is None:
            return
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        middle = self._canvas.to_screen(self._at)
        red, green, blue = get_theme_colours(self.palette()).axes
        self._ring(painter, middle, blue)
        self._arrow(painter, middle, QPointF(1, 0), red, part="x")
        self._arrow(painter, middle, QPointF(0, 1), green, part="y")
        square = QRectF(
            middle.x() - _MIDDLE_PX, middle.y() - _MIDDLE_PX, 2 * _MIDDLE_PX, 2 * _MIDDLE_PX
        )
        painter.setPen(QPen(QColor(255, 255, 255), 2.0))
        painter.setBrush(QColor(20, 24, 30, 220 if self._lit("xy") else 130))
        painter.drawRect(square)

    def _lit(self, part: GizmoPart) -> bool:
        return (self._held[0] if self._held is not None else self._under) == part

    def _ring(self, painter: QPainter, middle: QPointF, colour: Rgb) -> None:
        painter.setBrush(Qt.BrushStyle.NoBrush)
        for ink, wide in (
            (QColor(255, 255, 255, 190), 5.0),
            (to_qcolor(colour), 3.5 if self._lit("rz") else 2.0),
        ):
            painter.setPen(QPen(ink, wide))
            painter.drawEllipse(middle, _RING_PX, _RING_PX)

    def _arrow(
        self, painter: QPainter, middle: QPointF, way: QPointF, colour: Rgb, part: GizmoPart
    ) -> None:
        end = middle + way * _ARROW_PX
        aside = QPointF(-way.y(), way.x())
        tip = QPolygonF([end + way * _TIP_PX * 1.6, end + aside * _TIP_PX, end - aside * _TIP_PX])
        for ink, wide in (
            (QColor(255, 255, 255, 190), 6.0),
            (to_qcolor(colour), 4.0 if self._lit(part) else 2.5),
        ):
            painter.setPen(QPen(ink, wide))
            painter.setBrush(ink)
            painter.drawLine(middle, end)
            painter.setPen(QPen(ink, 1.0))
            painter.drawPolygon(tip)
