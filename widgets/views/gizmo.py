"""Gizmo over an image or a 3D view: arrows translate, rings rotate, the centre translates in the
plane of the view, and the space between them rotates freely. Shift is ten times as fine.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from PyQt6.QtCore import QEvent, QObject, QPointF, QRectF, Qt, pyqtSignal
from PyQt6.QtGui import QColor, QMouseEvent, QPainter, QPen, QPolygonF
from PyQt6.QtWidgets import QWidget

from pipeline.core.arrays import Doubles
from pipeline.core.geometry import rigid
from pipeline.sensors.alignment import AXES
from widgets.style.theme import get_theme_colours, to_qcolor

Project = Callable[[Doubles], Doubles]  # points (n, 3) in mm from the pivot -> pixels (n, 2)
CENTRE = "centre"
BALL = "ball"
_ARROW_PX = 46.0
_RING_PX = 66.0
_MIDDLE_PX = 8.0
_NEAR_PX = 7.0
_TIP_PX = 7.0
_SHORTEST_PX = 12.0  # an arrow that points to the eye is left out
_FLATTEST = 0.2  # and a ring that is seen from its edge
_FINE = 0.1  # of a motion with Shift
_CASING = QColor(255, 255, 255, 190)
_CIRCLE = np.stack([f(np.linspace(0.0, 2.0 * np.pi, 49)) for f in (np.cos, np.sin)], axis=-1)


class Gizmo(QWidget):
    """Lies over another widget; its parts take a drag before that widget does.

    `dragged` carries a translation (3,) in mm and a rotation (3, 3) about the pivot since
    `grabbed`. The free rotation is offered where `is_solid`: what is below is seen in 3D.
    """

    grabbed = pyqtSignal()
    dragged = pyqtSignal(object, object)
    released = pyqtSignal()

    def __init__(self, host: QWidget, *, is_solid: bool) -> None:
        super().__init__(host)
        self.setObjectName("gizmo")
        # the host's events are filtered instead
        self.setAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)
        self._host = host
        self._is_solid = is_solid
        self._project: Project | None = None
        self._held = ""  # part
        self._under = ""
        self._last = QPointF()  # where the mouse was
        self._shift_mm = np.zeros(3)
        self._rotation = np.eye(3)
        host.installEventFilter(self)
        self.hide()

    @property
    def is_dragging(self) -> bool:
        """Whether a part is being dragged."""
        return bool(self._held)

    def show_at(self, project: Project | None) -> None:
        """Show the gizmo where its pivot is projected to; None hides it."""
        self._project = project
        self.setGeometry(self._host.rect())
        self.setVisible(project is not None)
        if project is None:
            self._held = self._under = ""
        self.update()

    @property
    def centre(self) -> QPointF:
        """The position of the pivot."""
        x, y = self._find_px(np.zeros((1, 3)))[0]
        return QPointF(x, y)

    def part_at(self, at: QPointF) -> str:
        """Return the part at a position of the host; "" for none."""
        if self._project is None:
            return ""
        place = np.array([at.x(), at.y()])
        off = place - self._find_px(np.zeros((1, 3)))[0]
        if np.abs(off).max() <= _MIDDLE_PX:
            return CENTRE
        distances = {
            **{AXES[k]: _distance_px(self._find_arrow_px(k), place) for k in self._arrows},
            **{AXES[3 + k]: _distance_px(self._find_ring_px(k), place) for k in self._rings},
        }
        part = min(distances, key=distances.__getitem__, default="")
        if part and distances[part] < _NEAR_PX:
            return part
        return BALL if self._is_solid and math.hypot(*off) < _RING_PX else ""

    def eventFilter(self, a0: QObject | None, a1: QEvent | None) -> bool:  # noqa: N802
        """Handle the drags of its parts."""
        if a1 is not None and a1.type() == QEvent.Type.Resize:
            self.setGeometry(self._host.rect())
        if self.isHidden() or not isinstance(a1, QMouseEvent):
            return super().eventFilter(a0, a1)
        kind = a1.type()
        if kind == QEvent.Type.MouseButtonPress and a1.button() == Qt.MouseButton.LeftButton:
            part = self.part_at(a1.position())
            if part:
                self._held, self._last = part, a1.position()
                self._shift_mm, self._rotation = np.zeros(3), np.eye(3)
                self.grabbed.emit()
                return True
        if kind == QEvent.Type.MouseButtonRelease and self._held:
            self._held = ""
            self.released.emit()
            self.update()
            return True
        if kind == QEvent.Type.MouseMove:
            if self._held:
                self._drag(a1.position(), bool(a1.modifiers() & Qt.KeyboardModifier.ShiftModifier))
                return True
            if a1.buttons() == Qt.MouseButton.NoButton:
                self._point(self.part_at(a1.position()))
            return bool(self._under)
        return super().eventFilter(a0, a1)

    def _point(self, part: str) -> None:
        if part != self._under:
            self._under = part
            shapes = Qt.CursorShape
            self._host.setCursor(shapes.OpenHandCursor if part else shapes.ArrowCursor)
            self.update()

    def _drag(self, at: QPointF, fine: bool) -> None:
        scale = _FINE if fine else 1.0
        off = scale * np.array([at.x() - self._last.x(), at.y() - self._last.y()])
        part, px_of_mm = self._held, self._px_of_mm
        if part == CENTRE:
            chosen = px_of_mm * [k in self._arrows for k in range(3)]
            self._shift_mm = self._shift_mm + np.linalg.pinv(chosen) @ off
        elif part == BALL:
            self._turn(self._find_ball_rotation(off))
        elif part in AXES[:3]:
            axis = AXES.index(part)
            along = px_of_mm[:, axis]
            self._shift_mm[axis] += float(along @ off / max(along @ along, 1e-12))
        else:
            axis = AXES.index(part) - 3
            self._turn(np.eye(3)[axis] * scale * self._find_angle(axis, self._last, at))
        self._last = at
        self.dragged.emit(self._shift_mm.copy(), self._rotation.copy())

    def _turn(self, by_rad: Doubles) -> None:
        self._rotation = rigid.rotation(by_rad)[:3, :3] @ self._rotation

    def _find_ball_rotation(self, off_px: Doubles) -> Doubles:
        """Return the rotation vector that moves what is nearest to the eye with the mouse."""
        right, down = (row / max(float(np.linalg.norm(row)), 1e-12) for row in self._px_of_mm)
        return np.cross(np.cross(down, right), off_px[0] * right + off_px[1] * down) / _RING_PX

    def _find_angle(self, axis: int, begin: QPointF, end: QPointF) -> float:
        """Return the angle about an axis between two positions, in the plane of its ring."""
        others = [(axis + 1) % 3, (axis + 2) % 3]
        inverse = np.linalg.inv(self._px_of_mm[:, others])
        middle = self.centre
        x, y = (inverse @ (p.x() - middle.x(), p.y() - middle.y()) for p in (begin, end))
        return math.atan2(x[0] * y[1] - x[1] * y[0], x @ y)

    @property
    def _px_of_mm(self) -> Doubles:
        """How pixels change with each axis (2, 3) at the pivot."""
        ends = self._find_px(0.5 * np.concatenate([np.eye(3), -np.eye(3)]))
        return (ends[:3] - ends[3:]).T

    @property
    def _mm_of_px(self) -> float:
        """The length of a pixel along the axis that is seen best."""
        return 1.0 / max(float(np.linalg.norm(self._px_of_mm, axis=0).max()), 1e-9)

    @property
    def _arrows(self) -> list[int]:
        lengths = _ARROW_PX * self._mm_of_px * np.linalg.norm(self._px_of_mm, axis=0)
        return [k for k in range(3) if lengths[k] > _SHORTEST_PX]

    @property
    def _rings(self) -> list[int]:
        sides = self._px_of_mm * self._mm_of_px
        areas = [abs(float(np.linalg.det(sides[:, [(k + 1) % 3, (k + 2) % 3]]))) for k in range(3)]
        return [k for k in range(3) if areas[k] > _FLATTEST]

    def _find_px(self, points_mm: Doubles) -> Doubles:
        return np.zeros((len(points_mm), 2)) if self._project is None else self._project(points_mm)

    def _find_arrow_px(self, axis: int) -> Doubles:
        tip = _ARROW_PX * self._mm_of_px * np.eye(3)[axis]
        return self._find_px(np.stack([np.zeros(3), tip]))

    def _find_ring_px(self, axis: int) -> Doubles:
        circle = np.zeros((len(_CIRCLE), 3))
        circle[:, [(axis + 1) % 3, (axis + 2) % 3]] = _RING_PX * self._mm_of_px * _CIRCLE
        return self._find_px(circle)

    def paintEvent(self, a0: Any) -> None:  # noqa: N802
        """Paint rings, arrows, centre and the motion, with a casing that is visible on any
        image.
        """
        del a0
        if self._project is None:
            return
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        colours = [to_qcolor(colour) for colour in get_theme_colours(self.palette()).axes]
        for axis in self._rings:
            ring = QPolygonF([self._to_point(place) for place in self._find_ring_px(axis)])
            for ink, wide in self._choose_pens(AXES[3 + axis], colours[axis]):
                painter.setPen(QPen(ink, wide))
                painter.drawPolyline(ring)
        for axis in self._arrows:
            begin, end = self._find_arrow_px(axis)
            way = (end - begin) / max(float(np.linalg.norm(end - begin)), 1e-9)
            aside = np.array([-way[1], way[0]])
            corners = end + 1.6 * _TIP_PX * way, end + _TIP_PX * aside, end - _TIP_PX * aside
            tip = QPolygonF([self._to_point(place) for place in corners])
            for ink, wide in self._choose_pens(AXES[axis], colours[axis]):
                painter.setPen(QPen(ink, wide))
                painter.drawLine(self._to_point(begin), self._to_point(end))
                painter.setPen(QPen(ink, 1.0))
                painter.setBrush(ink)
                painter.drawPolygon(tip)
                painter.setBrush(Qt.BrushStyle.NoBrush)
        middle = self.centre
        side = QPointF(_MIDDLE_PX, _MIDDLE_PX)
        painter.setPen(QPen(QColor(255, 255, 255), 2.0))
        painter.setBrush(QColor(20, 24, 30, 220 if self._is_lit(CENTRE) else 130))
        painter.drawRect(QRectF(middle - side, middle + side))
        if self._held:
            painter.drawText(middle + QPointF(0.8 * _RING_PX, -0.8 * _RING_PX), self._motion_text)

    @property
    def _motion_text(self) -> str:
        """The motion since it was grabbed."""
        pose = np.eye(4)
        pose[:3, :3] = self._rotation
        values = (*self._shift_mm, *np.rad2deg(rigid.rotation_vector_rad(pose)))
        units = ("mm",) * 3 + ("°",) * 3
        return "  ".join(
            f"{axis} {value:+.2f} {unit}"
            for axis, value, unit in zip(AXES, values, units, strict=True)
            if abs(value) > 5e-3
        )

    def _is_lit(self, part: str) -> bool:
        return (self._held or self._under) == part

    def _choose_pens(self, part: str, colour: QColor) -> tuple[tuple[QColor, float], ...]:
        return (_CASING, 5.0), (colour, 4.0 if self._is_lit(part) else 2.0)

    @staticmethod
    def _to_point(place: Doubles) -> QPointF:
        return QPointF(float(place[0]), float(place[1]))


def _distance_px(line_px: Doubles, place: Doubles) -> float:
    """Return the distance of a position (2,) from a line through points (n, 2)."""
    begin, way = line_px[:-1], np.diff(line_px, axis=0)
    share = np.einsum("ij,ij->i", place - begin, way) / np.maximum((way**2).sum(axis=1), 1e-12)
    nearest = begin + np.clip(share, 0.0, 1.0)[:, None] * way
    return float(np.linalg.norm(place - nearest, axis=1).min())
