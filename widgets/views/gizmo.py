"""Gizmo over an image or a 3D view: arrows, rings and a centre that are dragged; Shift is ten times
as fine.
"""

import numpy as np
from PyQt6.QtCore import QEvent, QObject, QPointF, QRectF, Qt, pyqtSignal
from PyQt6.QtGui import QColor, QMouseEvent, QPainter, QPen
from PyQt6.QtWidgets import QWidget

from pipeline.core.arrays import Doubles
from pipeline.core.geometry import rigid
from pipeline.sensors.alignment import AXES
from pipeline.views.gizmo import (
    CENTRE,
    MIDDLE_PX,
    RING_PX,
    GizmoGeometry,
    Project,
    describe_motion,
)
from widgets.style.base import PaintedWidget
from widgets.style.theme import ThemeColours, to_qcolor
from widgets.views.preview_renderer import to_polygon

_TIP_PX = 7.0
_CASING = QColor(255, 255, 255, 190)


class Gizmo(PaintedWidget):
    """Lies over another widget; its parts take a drag before that widget does.

    `dragged` carries a translation (3,) in mm and a rotation (3, 3) about the pivot since
    `grabbed`.
    """

    grabbed = pyqtSignal()
    dragged = pyqtSignal(object, object)
    released = pyqtSignal()

    def __init__(self, host: QWidget, *, is_solid: bool) -> None:
        super().__init__("gizmo")
        self.setParent(host)
        # the host's events are filtered instead
        self.setAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)
        self._host = host
        self._is_solid = is_solid
        self._project: Project | None = None
        self._held = ""  # part
        self._under = ""
        self._last = np.zeros(2)  # where the mouse was
        self._shift_mm = np.zeros(3)
        self._rotation = np.eye(3)
        host.installEventFilter(self)
        self.hide()

    @property
    def geometry_px(self) -> GizmoGeometry | None:
        """Where its parts are now; None while it is hidden."""
        return (
            None if self._project is None else GizmoGeometry(self._project, is_solid=self._is_solid)
        )

    def show_at(self, project: Project | None) -> None:
        """Show the gizmo where its pivot is projected to; None hides it."""
        self._project = project
        self.setGeometry(self._host.rect())
        self.setVisible(project is not None)
        if project is None:
            self._held = self._under = ""
        self.update()

    def eventFilter(self, a0: QObject | None, a1: QEvent | None) -> bool:  # noqa: N802
        """Handle the drags of its parts."""
        if a1 is not None and a1.type() == QEvent.Type.Resize:
            self.setGeometry(self._host.rect())
        shape = self.geometry_px if isinstance(a1, QMouseEvent) else None
        if shape is None or not isinstance(a1, QMouseEvent):
            return super().eventFilter(a0, a1)
        kind, at = a1.type(), np.array([a1.position().x(), a1.position().y()])
        if kind == QEvent.Type.MouseButtonPress and a1.button() == Qt.MouseButton.LeftButton:
            self._held = shape.find_part(at)
            if self._held:
                self._last, self._shift_mm, self._rotation = at, np.zeros(3), np.eye(3)
                self.grabbed.emit()
        elif kind == QEvent.Type.MouseMove and self._held:
            fine = bool(a1.modifiers() & Qt.KeyboardModifier.ShiftModifier)
            shift, turn = shape.find_motion(self._held, self._last, at, fine=fine)
            self._shift_mm = self._shift_mm + shift
            self._rotation = rigid.rotation(turn)[:3, :3] @ self._rotation
            self._last = at
            self.dragged.emit(self._shift_mm, self._rotation)
        elif kind == QEvent.Type.MouseMove and a1.buttons() == Qt.MouseButton.NoButton:
            self._point(shape.find_part(at))
            return bool(self._under)
        elif kind == QEvent.Type.MouseButtonRelease and self._held:
            self._held = ""
            self.released.emit()
            self.update()
            return True
        return bool(self._held) or super().eventFilter(a0, a1)

    def _point(self, part: str) -> None:
        if part != self._under:
            self._under = part
            shapes = Qt.CursorShape
            self._host.setCursor(shapes.OpenHandCursor if part else shapes.ArrowCursor)
            self.update()

    def paint(self, painter: QPainter, ink: ThemeColours) -> None:
        """Paint rings, arrows, centre and the motion, with a casing that is visible on any
        image.
        """
        shape = self.geometry_px
        if shape is None:
            return
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        colours: dict[str, QColor] = dict(zip(AXES, map(to_qcolor, ink.axes * 2), strict=True))
        for part, line in {**shape.rings_px, **shape.arrows_px}.items():
            for side, wide in (_CASING, 5.0), (colours[part], 4.0 if self._is_lit(part) else 2.0):
                painter.setPen(QPen(side, wide))
                painter.drawPolyline(to_polygon(line))
                if part in shape.arrows_px:
                    painter.setBrush(side)
                    painter.drawPolygon(to_polygon(_make_tip(*line)))
                    painter.setBrush(Qt.BrushStyle.NoBrush)
        middle = QPointF(*shape.centre_px)
        side = QPointF(MIDDLE_PX, MIDDLE_PX)
        painter.setPen(QPen(QColor(255, 255, 255), 2.0))
        painter.setBrush(QColor(20, 24, 30, 220 if self._is_lit(CENTRE) else 130))
        painter.drawRect(QRectF(middle - side, middle + side))
        if self._held:
            text = describe_motion(self._shift_mm, self._rotation)
            painter.drawText(middle + 0.8 * QPointF(RING_PX, -RING_PX), text)

    def _is_lit(self, part: str) -> bool:
        return (self._held or self._under) == part


def _make_tip(begin: Doubles, end: Doubles) -> Doubles:
    """Return the corners (3, 2) of an arrow's tip."""
    way = _TIP_PX * (end - begin) / max(float(np.linalg.norm(end - begin)), 1e-9)
    aside = np.array([-way[1], way[0]])
    return end + np.stack([way, 0.6 * aside, -0.6 * aside])
