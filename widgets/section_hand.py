"""A line that is laid into a picture by the mouse: with Shift anew, or one of its ends."""

from __future__ import annotations

from PyQt6.QtCore import QEvent, QObject, QPointF, Qt, pyqtSignal
from PyQt6.QtGui import QMouseEvent

from widgets.canvas import Canvas

_NEAR_PX = 9.0
_Ends = tuple[QPointF, QPointF]


class SectionHand(QObject):
    """Draws the line over a canvas and takes the drags that are about it; without a line it does not even listen."""

    moved = pyqtSignal(QPointF, QPointF)  # beginning and end, in pixels of the picture

    def __init__(self, canvas: Canvas) -> None:
        super().__init__(canvas)
        self._canvas = canvas
        self._fixed: QPointF | None = None  # the end that stays, while the other is dragged
        self._begins = False  # whether the dragged end is the first

    def show_line(self, ends: _Ends | None) -> None:
        """Draw the line there, in pixels of the picture; None takes it away."""
        if (ends is None) != (self._canvas.line is None):
            if ends is None:
                self._canvas.removeEventFilter(self)
                self._fixed = None
            else:
                self._canvas.installEventFilter(self)
        self._canvas.show_line(ends)

    def eventFilter(self, a0: QObject | None, a1: QEvent | None) -> bool:  # noqa: N802
        """Drags of the line come before those of the picture."""
        if not isinstance(a1, QMouseEvent) or self._canvas.line is None:
            return super().eventFilter(a0, a1)
        kind, at = a1.type(), a1.position()
        if kind == QEvent.Type.MouseButtonPress and a1.button() == Qt.MouseButton.LeftButton:
            return self._take(at, anew=bool(a1.modifiers() & Qt.KeyboardModifier.ShiftModifier))
        if self._fixed is None:
            return super().eventFilter(a0, a1)
        if kind == QEvent.Type.MouseMove:
            there = self._canvas.to_picture(at)
            self.moved.emit(*((there, self._fixed) if self._begins else (self._fixed, there)))
            return True
        if kind == QEvent.Type.MouseButtonRelease:
            self._fixed = None
            return True
        return super().eventFilter(a0, a1)

    def _take(self, at: QPointF, *, anew: bool) -> bool:
        begin, end = self._canvas.line or (QPointF(), QPointF())
        if anew:
            self._fixed, self._begins = self._canvas.to_picture(at), False
            return True
        for first, own, other in ((False, end, begin), (True, begin, end)):
            if (self._canvas.to_screen(own) - at).manhattanLength() < _NEAR_PX:
                self._fixed, self._begins = QPointF(other), first
                return True
        return False
