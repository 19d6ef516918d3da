"""Small drawn icons: states of a stage, and commands for which Qt has none."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

from PyQt6.QtCore import QPointF, QRectF, Qt
from PyQt6.QtGui import QColor, QIcon, QPainter, QPen, QPixmap, QPolygonF

from widgets.colours import STATES, qcolor

_SIZE = 32  # drawn large and scaled down, sharp on dense screens
_INK = QColor(60, 66, 76)


def _tick(p: QPainter) -> None:
    p.drawPolyline(QPolygonF([QPointF(9, 17), QPointF(14, 22), QPointF(23, 11)]))


def _stack(p: QPainter) -> None:
    for y in (11, 16, 21):
        p.drawLine(QPointF(10, y), QPointF(22, y))


def _equal(p: QPainter) -> None:
    for y in (13, 19):
        p.drawLine(QPointF(10, y), QPointF(22, y))


def _dash(p: QPainter) -> None:
    p.drawLine(QPointF(10, 16), QPointF(22, 16))


def _arc(p: QPainter) -> None:
    p.drawArc(QRectF(10, 10, 12, 12), 90 * 16, -250 * 16)


def _cross(p: QPainter) -> None:
    p.drawLine(QPointF(11, 11), QPointF(21, 21))
    p.drawLine(QPointF(21, 11), QPointF(11, 21))


def _hand(p: QPainter) -> None:
    p.drawPolyline(QPolygonF([QPointF(16, 9), QPointF(16, 16), QPointF(21, 19)]))


def _dot(p: QPainter) -> None:
    p.drawPoint(QPointF(16, 16))


_MARKS: dict[str, Callable[[QPainter], None]] = {
    "computed": _tick,
    "read": _tick, "cached": _stack, "unchanged": _equal, "skipped": _dash,
    "running": _arc, "preview": _stack, "failed": _cross, "stale": _hand, "waiting": _dot,
}  # fmt: skip


@lru_cache(maxsize=32)
def state_pixmap(state: str, size_px: int = 16) -> QPixmap:
    """A round sign for the state of a stage: told apart by its mark, not by its colour alone."""
    colour = qcolor(STATES[state])
    pixmap, painter = _canvas()
    painter.setPen(QPen(colour, 2))
    painter.setBrush(QColor(colour.red(), colour.green(), colour.blue(), 40))
    painter.drawEllipse(QRectF(3, 3, 26, 26))
    painter.setPen(QPen(colour, 3, cap=Qt.PenCapStyle.RoundCap, join=Qt.PenJoinStyle.RoundJoin))
    painter.setBrush(Qt.BrushStyle.NoBrush)
    _MARKS[state](painter)
    painter.end()
    return pixmap.scaled(
        size_px, size_px, Qt.AspectRatioMode.KeepAspectRatio, Qt.TransformationMode.SmoothTransformation
    )


def _link(p: QPainter) -> None:
    p.drawEllipse(QRectF(4, 11, 12, 10))
    p.drawEllipse(QRectF(16, 11, 12, 10))


def _reset(p: QPainter) -> None:
    p.drawArc(QRectF(7, 7, 18, 18), 60 * 16, 290 * 16)
    p.drawPolyline(QPolygonF([QPointF(22, 3), QPointF(21, 9), QPointF(27, 10)]))


def _cube(p: QPainter) -> None:
    p.drawPolygon(
        QPolygonF([QPointF(16, 4), QPointF(27, 10), QPointF(27, 22), QPointF(16, 28), QPointF(5, 22), QPointF(5, 10)])
    )
    p.drawPolyline(QPolygonF([QPointF(5, 10), QPointF(16, 16), QPointF(27, 10)]))
    p.drawLine(QPointF(16, 16), QPointF(16, 28))


def _target(p: QPainter) -> None:
    p.drawEllipse(QRectF(8, 8, 16, 16))
    for a, b in (((16, 3), (16, 12)), ((16, 20), (16, 29)), ((3, 16), (12, 16)), ((20, 16), (29, 16))):
        p.drawLine(QPointF(*a), QPointF(*b))


def _picture(p: QPainter) -> None:
    p.drawRoundedRect(QRectF(4, 7, 24, 18), 2, 2)
    p.drawPolyline(QPolygonF([QPointF(5, 23), QPointF(12, 15), QPointF(17, 20), QPointF(21, 16), QPointF(27, 22)]))
    p.drawEllipse(QRectF(19, 10, 3, 3))


def _loop(p: QPainter) -> None:
    p.drawRoundedRect(QRectF(5, 9, 22, 14), 7, 7)
    p.drawPolyline(QPolygonF([QPointF(13, 5), QPointF(18, 9), QPointF(13, 13)]))


_DRAWINGS: dict[str, Callable[[QPainter], None]] = {
    "link": _link, "reset": _reset, "cube": _cube, "target": _target, "picture": _picture, "loop": _loop,
}  # fmt: skip


@lru_cache(maxsize=32)
def drawn(name: str) -> QIcon:
    """The drawn icon of a command."""
    pixmap, painter = _canvas()
    painter.setPen(QPen(_INK, 2.4, cap=Qt.PenCapStyle.RoundCap, join=Qt.PenJoinStyle.RoundJoin))
    _DRAWINGS[name](painter)
    painter.end()
    return QIcon(pixmap)


def _canvas() -> tuple[QPixmap, QPainter]:
    pixmap = QPixmap(_SIZE, _SIZE)
    pixmap.fill(Qt.GlobalColor.transparent)
    painter = QPainter(pixmap)
    painter.setRenderHint(QPainter.RenderHint.Antialiasing)
    return pixmap, painter
