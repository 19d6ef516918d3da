"""Icons drawn in the colours of the current palette: stage states and commands."""

from __future__ import annotations

from PyQt6.QtCore import QPointF, QRect, QRectF, QSize, Qt
from PyQt6.QtGui import QColor, QGuiApplication, QIcon, QIconEngine, QPainter, QPalette, QPen, QPixmap, QPolygonF
from PyQt6.QtWidgets import QWidget

from widgets.icon_drawings import CANVAS_PX, COMMAND_DRAWINGS, STATE_DRAWINGS, IconDrawing
from widgets.theme import get_theme_colours, to_qcolor

_LINE_PX, _MARK_PX = 2.4, 3.0  # in pixels of the drawings' canvas
_FAINT = 90  # of 255: a disabled command


def make_command_icon(name: str) -> QIcon:
    """Return the icon of a command."""
    return QIcon(_Engine(COMMAND_DRAWINGS[name], state=""))


def make_state_icon(state: str) -> QIcon:
    """Return the sign of a state, for tables."""
    return QIcon(_Engine(STATE_DRAWINGS[state], state=state))


def paint_state(painter: QPainter, room: QRectF, state: str, palette: QPalette) -> None:
    """Paint the round sign of a stage's state; states differ by their mark, not by colour alone."""
    ink = to_qcolor(get_theme_colours(palette).states[state])
    with _Canvas(painter, room):
        painter.setPen(QPen(ink, 2))
        painter.setBrush(QColor(ink.red(), ink.green(), ink.blue(), 40))
        painter.drawEllipse(QRectF(3, 3, 26, 26))
        _draw(painter, STATE_DRAWINGS[state], ink, _MARK_PX)


class StateIcon(QWidget):
    """The sign of a state; keeps its room while there is none."""

    def __init__(self, size_px: int = 16, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.state = ""
        self.setFixedSize(size_px, size_px)

    def show_state(self, state: str) -> None:
        """Show another sign; "" for none."""
        if state != self.state:
            self.state = state
            self.setAccessibleName(state)
            self.update()

    def paintEvent(self, a0: object) -> None:  # noqa: N802
        """Paint the sign."""
        del a0
        if self.state:
            paint_state(QPainter(self), QRectF(self.rect()), self.state, self.palette())


class _Engine(QIconEngine):
    """Icon engine that paints on request, so that an icon follows theme and screen density."""

    def __init__(self, drawing: IconDrawing, *, state: str) -> None:
        super().__init__()
        self._drawing, self._state = drawing, state

    def clone(self) -> QIconEngine:
        return _Engine(self._drawing, state=self._state)

    def pixmap(self, size: QSize, mode: QIcon.Mode, state: QIcon.State) -> QPixmap:
        pixmap = QPixmap(size)
        pixmap.fill(Qt.GlobalColor.transparent)
        painter = QPainter(pixmap)
        self.paint(painter, QRect(0, 0, size.width(), size.height()), mode, state)
        painter.end()
        return pixmap

    def paint(self, painter: QPainter | None, rect: QRect, mode: QIcon.Mode, state: QIcon.State) -> None:
        del state
        if painter is None:
            return
        palette = QGuiApplication.palette()
        if self._state:
            paint_state(painter, QRectF(rect), self._state, palette)
            return
        ink = to_qcolor(get_theme_colours(palette).icon, _FAINT if mode == QIcon.Mode.Disabled else 255)
        with _Canvas(painter, QRectF(rect)):
            _draw(painter, self._drawing, ink, _LINE_PX)


class _Canvas:
    """The canvas of the drawings, mapped to a rectangle."""

    def __init__(self, painter: QPainter, room: QRectF) -> None:
        self._painter, self._room = painter, room

    def __enter__(self) -> None:
        painter, room = self._painter, self._room
        side = min(room.width(), room.height())
        painter.save()
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        painter.translate(room.center() - QPointF(0.5 * side, 0.5 * side))
        painter.scale(side / CANVAS_PX, side / CANVAS_PX)

    def __exit__(self, *_: object) -> None:
        self._painter.restore()


def _draw(painter: QPainter, drawing: IconDrawing, ink: QColor, width_px: float) -> None:
    painter.setPen(QPen(ink, width_px, cap=Qt.PenCapStyle.RoundCap, join=Qt.PenJoinStyle.RoundJoin))
    painter.setBrush(Qt.BrushStyle.NoBrush)
    for x, y, width, height, begin_deg, by_deg in drawing.arcs:
        painter.drawArc(QRectF(x, y, width, height), 16 * begin_deg, 16 * by_deg)
    for x, y, width, height, radius in drawing.boxes:
        painter.drawRoundedRect(QRectF(x, y, width, height), radius, radius)
    for stroke in drawing.strokes:
        painter.drawPolyline(_corners(stroke))
    painter.setBrush(ink)
    for shape in drawing.filled:
        painter.drawPolygon(_corners(shape))


def _corners(stroke: str) -> QPolygonF:
    return QPolygonF([QPointF(*map(float, corner.split(","))) for corner in stroke.split()])
