"""Small drawn icons: states of a stage, and commands for which Qt has none."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

from PyQt6.QtCore import QPointF, QRectF, Qt
from PyQt6.QtGui import QColor, QIcon, QPainter, QPen, QPixmap, QPolygonF

from widgets.colours import STATES, qcolor

_SIZE = 32  # drawn large and scaled down, sharp on dense screens
_INK = QColor(60, 66, 76)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Sign:
    """Lines of a drawing, in pixels of the canvas."""

    strokes: tuple[str, ...] = ()  # the corners of each: "x,y x,y ..."
    arcs: tuple[tuple[int, int, int, int, int, int], ...] = ()  # x, y, width, height, from and by how many degrees
    boxes: tuple[tuple[int, int, int, int, int], ...] = ()  # x, y, width, height, radius of the corners


_TICK, _STACK = _Sign(strokes=("9,17 14,22 23,11",)), _Sign(strokes=("10,11 22,11", "10,16 22,16", "10,21 22,21"))
_MARKS = {
    "computed": _TICK,
    "read": _TICK,
    "cached": _STACK,
    "unchanged": _Sign(strokes=("10,13 22,13", "10,19 22,19")),
    "skipped": _Sign(strokes=("10,16 22,16",)),
    "running": _Sign(arcs=((10, 10, 12, 12, 90, -250),)),
    "preview": _STACK,
    "doubtful": _Sign(strokes=("16,8 16,18", "16,23 16.01,23")),
    "failed": _Sign(strokes=("11,11 21,21", "21,11 11,21")),
    "stale": _Sign(strokes=("16,9 16,16 21,19",)),
    "waiting": _Sign(strokes=("16,16 16.01,16",)),  # a dot
}
_DRAWINGS = {
    "link": _Sign(arcs=((4, 11, 12, 10, 0, 360), (16, 11, 12, 10, 0, 360))),
    "reset": _Sign(arcs=((7, 7, 18, 18, 60, 290),), strokes=("22,3 21,9 27,10",)),
    "cube": _Sign(strokes=("16,4 27,10 27,22 16,28 5,22 5,10 16,4", "5,10 16,16 27,10", "16,16 16,28")),
    "target": _Sign(arcs=((8, 8, 16, 16, 0, 360),), strokes=("16,3 16,12", "16,20 16,29", "3,16 12,16", "20,16 29,16")),
    "picture": _Sign(
        boxes=((4, 7, 24, 18, 2),), strokes=("5,23 12,15 17,20 21,16 27,22",), arcs=((19, 10, 3, 3, 0, 360),)
    ),
    "table": _Sign(boxes=((5, 6, 22, 20, 2),), strokes=("5,13 27,13", "5,19 27,19", "13,6 13,26")),
    "sliders": _Sign(strokes=("5,9 27,9", "5,16 27,16", "5,23 27,23", "11,6 11,12", "21,13 21,19", "14,20 14,26")),
    "axes": _Sign(strokes=("12,20 12,4", "12,20 28,20", "12,20 4,28", "9,8 12,4 15,8", "24,17 28,20 24,23")),
    "lines": _Sign(strokes=("5,8 27,8", "5,14 22,14", "5,20 27,20", "5,26 17,26")),
    "tick": _Sign(strokes=("6,17 13,24 26,8",)),
    "minus": _Sign(boxes=((5, 5, 22, 22, 3),), strokes=("11,12 21,12", "16,7 16,17", "11,22 21,22")),
    "wipe": _Sign(boxes=((4, 7, 24, 18, 2),), strokes=("16,3 16,29", "10,13 7,16 10,19", "22,13 25,16 22,19")),
    "blink": _Sign(arcs=((4, 9, 24, 16, 20, 140), (4, 7, 24, 16, 200, 140), (13, 12, 7, 7, 0, 360))),
    "panes": _Sign(
        boxes=((4, 6, 11, 20, 2), (17, 6, 11, 20, 2)),
    ),
    "fit": _Sign(
        strokes=("4,11 4,5 10,5", "22,5 28,5 28,11", "28,21 28,27 22,27", "10,27 4,27 4,21"),
        boxes=((11, 12, 10, 8, 4),),
    ),
    "worst": _Sign(strokes=("5,27 27,27", "8,27 8,20", "14,27 14,6", "20,27 20,17", "26,27 26,22")),
    "loop": _Sign(boxes=((5, 9, 22, 14, 7),), strokes=("13,5 18,9 13,13",)),
}


@lru_cache(maxsize=32)
def state_pixmap(state: str, size_px: int = 16) -> QPixmap:
    """A round sign for the state of a stage: told apart by its mark, not by its colour alone."""
    pixmap, painter = _canvas()
    painter.setPen(QPen(qcolor(STATES[state]), 2))
    painter.setBrush(qcolor(STATES[state], 40))
    painter.drawEllipse(QRectF(3, 3, 26, 26))
    painter.setBrush(Qt.BrushStyle.NoBrush)
    _draw(painter, _MARKS[state], qcolor(STATES[state]), 3)
    return pixmap.scaled(
        size_px, size_px, Qt.AspectRatioMode.KeepAspectRatio, Qt.TransformationMode.SmoothTransformation
    )


@lru_cache(maxsize=32)
def drawn(name: str) -> QIcon:
    """The drawn icon of a command."""
    pixmap, painter = _canvas()
    _draw(painter, _DRAWINGS[name], _INK, 2.4)
    return QIcon(pixmap)


def _canvas() -> tuple[QPixmap, QPainter]:
    pixmap = QPixmap(_SIZE, _SIZE)
    pixmap.fill(Qt.GlobalColor.transparent)
    painter = QPainter(pixmap)
    painter.setRenderHint(QPainter.RenderHint.Antialiasing)
    return pixmap, painter


def _draw(painter: QPainter, sign: _Sign, ink: QColor, width_px: float) -> None:
    """The last that is drawn on a canvas."""
    painter.setPen(QPen(ink, width_px, cap=Qt.PenCapStyle.RoundCap, join=Qt.PenJoinStyle.RoundJoin))
    for x, y, width, height, begin_deg, by_deg in sign.arcs:
        painter.drawArc(QRectF(x, y, width, height), 16 * begin_deg, 16 * by_deg)
    for x, y, width, height, radius in sign.boxes:
        painter.drawRoundedRect(QRectF(x, y, width, height), radius, radius)
    for stroke in sign.strokes:
        painter.drawPolyline(QPolygonF([QPointF(*map(float, corner.split(","))) for corner in stroke.split()]))
    painter.end()
