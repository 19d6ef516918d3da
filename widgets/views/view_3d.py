"""One 3D view as a plain widget: the last rendering, a marker, and mouse events for the
renderer.
"""

from collections.abc import Callable, Mapping
from typing import Any

from PyQt6.QtCore import QEvent, QPoint, QPointF, QRectF, Qt, pyqtSignal
from PyQt6.QtGui import QImage, QKeyEvent, QPainter, QPen

from widgets.style.base import YIELDS, EventListener, PaintedWidget
from widgets.style.theme import CROSSHAIR_COLOUR, ThemeColours, to_qcolor

_DOT_PX = 5.0
_MARGIN_PX = 12
_BAR_PX = 3.0
_ROOM_PX = 80.0  # left of the scale bar, for its text
_A_CLICK_PX = 4.0  # a release closer to its press than this is a click


class View3D(PaintedWidget):
    """Shows an image; `wanted` requests one of the current size."""

    image_requested = pyqtSignal()
    hovered = pyqtSignal(QPointF)  # mouse position, no button down
    clicked = pyqtSignal(QPointF)  # a click, not the end of a rotation
    menu_requested = pyqtSignal(QPoint)  # a click of the right button, not the end of a zoom
    key_pressed = pyqtSignal(int)  # one of `keys`

    def __init__(self) -> None:
        super().__init__(across=YIELDS, down=YIELDS)  # the image follows the widget's size
        self.setMinimumSize(60, 60)
        self.image: QImage | None = None
        self.notice = ""  # shown in place of an image
        self.marker: QPointF | None = None
        self.labels: Mapping[str, QPointF] = {}  # text -> where it is
        self.scale_bar = (0.0, "")  # length in pixels, and in words; "" = none
        self.keys = frozenset[Qt.Key]()  # that it takes from the window while it has the focus
        self._pressed: QPointF | None = None
        self.setMouseTracking(True)
        kinds = QEvent.Type.Resize, QEvent.Type.Show, QEvent.Type.PaletteChange
        # nothing is rendered while it is hidden
        EventListener(self, self.image_requested.emit, *kinds)
        # of an event and what it is: press, release, move or wheel
        self.mouse_handler: Callable[[Any, str], None] | None = None

    @property
    def size_px(self) -> tuple[int, int]:
        """Return width and height of the image in physical pixels."""
        dense = self.devicePixelRatioF()
        return max(1, round(dense * self.width())), max(1, round(dense * self.height()))

    def show_image(self, image: QImage) -> None:
        """Show another image."""
        if image is not self.image:
            self.image = image
            self.update()

    def show_signs(
        self, marker: QPointF | None, labels: Mapping[str, QPointF], scale_bar: tuple[float, str]
    ) -> None:
        """Show the probe's marker, None for none, short texts beside points, and a scale bar."""
        if (marker, labels, scale_bar) != (self.marker, self.labels, self.scale_bar):
            self.marker, self.labels, self.scale_bar = marker, labels, scale_bar
            self.update()

    def show_notice(self, text: str) -> None:
        """Show why there is no image."""
        self.notice = text
        self.update()

    def paint(self, painter: QPainter, ink: ThemeColours) -> None:
        """Paint the last image, or the backdrop until there is one."""
        if self.image is None:
            painter.fillRect(self.rect(), to_qcolor(ink.backdrop))
            room = self.rect().adjusted(_MARGIN_PX, 0, -_MARGIN_PX, 0)
            painter.drawText(
                room, Qt.AlignmentFlag.AlignCenter | Qt.TextFlag.TextWordWrap, self.notice
            )
            return
        painter.drawImage(QRectF(self.rect()), self.image)
        for text, at in self.labels.items():
            place = at + QPointF(_DOT_PX, -_DOT_PX)
            for side, moved in (self.palette().window(), 1.0), (self.palette().windowText(), 0.0):
                painter.setPen(side.color())
                painter.drawText(place + QPointF(moved, moved), text)
        if self.scale_bar[1]:
            self._paint_scale(painter, *self.scale_bar)
        if self.marker is not None:
            painter.setRenderHint(QPainter.RenderHint.Antialiasing)
            painter.setPen(QPen(Qt.GlobalColor.white, 1.5))
            painter.setBrush(to_qcolor(CROSSHAIR_COLOUR))
            painter.drawEllipse(self.marker, _DOT_PX, _DOT_PX)

    def _paint_scale(self, painter: QPainter, length_px: float, text: str) -> None:
        end = QPointF(self.width() - _MARGIN_PX, _MARGIN_PX + painter.fontMetrics().height())
        begin = end - QPointF(length_px, 0.0)
        painter.setPen(QPen(self.palette().windowText().color(), _BAR_PX))
        painter.drawLine(begin, end)
        room = QRectF(begin - QPointF(_ROOM_PX, end.y()), end + QPointF(0.0, -_BAR_PX))
        painter.drawText(room, Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignBottom, text)

    def event(self, a0: QEvent | None) -> bool:
        """Take its keys before they become shortcuts of the window."""
        kind = QEvent.Type.ShortcutOverride
        if isinstance(a0, QKeyEvent) and a0.type() == kind and self._takes(a0):
            a0.accept()
            return True
        return super().event(a0)

    def keyPressEvent(self, a0: Any) -> None:  # noqa: N802
        """Emit its keys."""
        if self._takes(a0):
            self.key_pressed.emit(a0.key())
        else:
            super().keyPressEvent(a0)

    def _takes(self, key: QKeyEvent) -> bool:
        return key.key() in self.keys and not key.modifiers()

    def mousePressEvent(self, a0: Any) -> None:  # noqa: N802
        """Begin to move the camera."""
        self._pressed = a0.position()
        self._pass_on(a0, "press")

    def mouseReleaseEvent(self, a0: Any) -> None:  # noqa: N802
        """Stop moving the camera; without a motion, emit a click."""
        self._pass_on(a0, "release")
        if (
            self._pressed is not None
            and (a0.position() - self._pressed).manhattanLength() < _A_CLICK_PX
        ):
            if a0.button() == Qt.MouseButton.LeftButton:
                self.clicked.emit(a0.position())
            elif a0.button() == Qt.MouseButton.RightButton:
                self.menu_requested.emit(a0.globalPosition().toPoint())
        self._pressed = None

    def mouseMoveEvent(self, a0: Any) -> None:  # noqa: N802
        """Move the camera while a button is down; else emit the position."""
        if a0.buttons() == Qt.MouseButton.NoButton:
            self.hovered.emit(a0.position())
        else:
            self._pass_on(a0, "move")

    def wheelEvent(self, a0: Any) -> None:  # noqa: N802
        """Zoom."""
        self._pass_on(a0, "wheel")

    def _pass_on(self, event: Any, what: str) -> None:
        if self.mouse_handler is not None:
            self.mouse_handler(event, what)
