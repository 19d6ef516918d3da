"""Section line drawn by mouse on an image: Shift draws a new one; ends can be dragged and moved by arrow keys."""

from PyQt6.QtCore import QEvent, QObject, QPointF, Qt, pyqtSignal
from PyQt6.QtGui import QKeyEvent, QMouseEvent

from widgets.canvas import Canvas
from widgets.preview_key_filter import get_arrow_step_px

_NEAR_PX = 9.0
_Modifier = Qt.KeyboardModifier
_Ends = tuple[QPointF, QPointF]


class SectionLineTool(QObject):
    """Paints the line on a canvas and takes the drags of it; listens only while there is a line."""

    line_moved = pyqtSignal(QPointF, QPointF)  # start and end, in image pixels

    def __init__(self, canvas: Canvas) -> None:
        super().__init__(canvas)
        self._canvas = canvas
        self._fixed: QPointF | None = None  # the fixed end during a drag
        self._begins = False  # whether the dragged end is the first

    def show_line(self, ends: _Ends | None) -> None:
        """Show the line, in image pixels; None removes it."""
        if (ends is None) != (self._canvas.line is None):
            if ends is None:
                self._canvas.removeEventFilter(self)
                self._fixed = None
            else:
                self._canvas.installEventFilter(self)
        self._canvas.show_line(ends)

    def eventFilter(self, a0: QObject | None, a1: QEvent | None) -> bool:  # noqa: N802
        """Handle drags and arrow keys of the line before those of the canvas."""
        taken = False
        if self._canvas.line is None:
            pass
        elif isinstance(a1, QMouseEvent):
            taken = self._drag(a1)
        elif isinstance(a1, QKeyEvent) and a1.type() == QEvent.Type.KeyPress:
            taken = self._step(a1)
        return taken or super().eventFilter(a0, a1)

    def _drag(self, event: QMouseEvent) -> bool:
        kind, at = event.type(), event.position()
        if kind == QEvent.Type.MouseButtonPress and event.button() == Qt.MouseButton.LeftButton:
            return self._take(at, anew=bool(event.modifiers() & _Modifier.ShiftModifier))
        if self._fixed is None:
            return False
        if kind == QEvent.Type.MouseMove:
            there = self._canvas.to_image(at)
            self.line_moved.emit(*((there, self._fixed) if self._begins else (self._fixed, there)))
        elif kind == QEvent.Type.MouseButtonRelease:
            self._fixed = None
        else:
            return False
        return True

    def _step(self, key: QKeyEvent) -> bool:
        step, how = QPointF(*get_arrow_step_px(key)), key.modifiers()
        if step.isNull() or self._canvas.line is None:
            return False
        begin, end = self._canvas.line
        only_a, only_b = (bool(how & one) for one in (_Modifier.ControlModifier, _Modifier.AltModifier))
        self.line_moved.emit(begin if only_b else begin + step, end if only_a else end + step)
        return True

    def _take(self, at: QPointF, *, anew: bool) -> bool:
        begin, end = self._canvas.line or (QPointF(), QPointF())
        if anew:
            self._fixed, self._begins = self._canvas.to_image(at), False
            return True
        for first, own, other in ((False, end, begin), (True, begin, end)):
            if (self._canvas.to_screen(own) - at).manhattanLength() < _NEAR_PX:
                self._fixed, self._begins = QPointF(other), first
                return True
        return False
