"""Canvas of an image: pan, zoom and a crosshair.

The rendered image is cached, so that moving the crosshair costs one copy and two lines.
"""

import math
from typing import Any

from PyQt6.QtCore import QEvent, QPointF, QRectF, Qt, pyqtSignal
from PyQt6.QtGui import QColor, QPainter, QPalette, QPen, QPixmap

from pipeline.core.arrays import Image
from pipeline.views.colours import Rgb
from pipeline.views.drawing import CASING_COLOUR
from pipeline.views.preview import Preview
from widgets.style.base import YIELDS, PaintedWidget
from widgets.style.theme import (
    CROSSHAIR_COLOUR,
    SECTION_COLOUR,
    ThemeColours,
    get_backdrop,
    get_probe_colour,
    get_theme_colours,
    to_qcolor,
)
from widgets.views.preview_renderer import MAX_ZOOM, MIN_ZOOM, PreviewRenderer

_A_CLICK_PX = 4.0  # a release closer to its press than this is a click
_ZOOM_STEP = 1.25
_PER_NOTCH = 120.0  # Qt's units per wheel notch
_NEAR_PX = 6.0
_END_PX = 6.5
# radius of a pinned pixel's mark: limits, and share of the height
_MARK_PX = (6.5, 8.0)
_MARK_SHARE = 0.05


class Canvas(PaintedWidget):
    """Draws one `Preview`; emits the position of the mouse, clicks, and changes of the view."""

    mouse_moved = pyqtSignal(QPointF)
    mouse_left = pyqtSignal()
    clicked = pyqtSignal(QPointF)
    view_changed = pyqtSignal()  # by the user
    handle_dragged = pyqtSignal(float)  # to this share of the width

    def __init__(self) -> None:
        super().__init__(across=YIELDS)
        self.setMinimumSize(60, 60)
        self.setMouseTracking(True)
        self._plate = PreviewRenderer()
        self._plate.set_theme(get_theme_colours(self.palette()))
        self.is_fitted = True  # the whole image is in view at any size
        self._kept: QPixmap | None = None
        self.crosshair: tuple[int, int] | None = None  # row, col
        self.crosshair_text = ""  # value shown at the crosshair
        # number, (row, col) of the pinned pixels
        self.marks: tuple[tuple[int, tuple[int, int]], ...] = ()
        self.line: tuple[QPointF, QPointF] | None = None  # section line, in image pixels
        # share of the width where the overlay begins, None = no handle
        self.handle_share: float | None = None
        self.handle_words: tuple[str, str] = ("", "")  # what is at its left and right
        self._pressed: QPointF | None = None
        self._dragged: QPointF | None = None
        self._drags_handle = False
        self.n_renders = 0  # number of times the image was rendered

    def show_preview(self, picture: Preview | None) -> None:
        """Show another image, None for no image; an image of the same size keeps the view."""
        if self._plate.set_preview(picture):
            self.fit_view()
        self.invalidate()

    def show_overlay(self, pixels: Image | None, share: float = 0.0) -> None:
        """Show an image of the same size over the first, from `share` of the width on.

        None removes it.
        """
        self._plate.set_overlay(pixels, share)
        self.invalidate()

    def move_overlay(self, share: float) -> None:
        """Set the share of the width where the overlay begins."""
        if self._plate.overlay is not None:
            self._plate.overlay = (self._plate.overlay[0], share)
            self.invalidate()

    def show_crosshair(self, pixel: tuple[int, int] | None, tag: str = "") -> None:
        """Show the crosshair at (row, col) with a value; None hides it."""
        if (pixel, tag) != (self.crosshair, self.crosshair_text):
            self.crosshair = pixel
            self.crosshair_text = tag
            self.update()

    def show_marks(self, marks: tuple[tuple[int, tuple[int, int]], ...]) -> None:
        """Show numbered marks of pinned pixels: (number, (row, col))."""
        if marks != self.marks:
            self.marks = marks
            self.update()

    def show_line(self, ends: tuple[QPointF, QPointF] | None) -> None:
        """Show a line from A to B, in image pixels; None removes it."""
        if ends != self.line:
            self.line = ends
            self.update()

    def fit_view(self) -> None:
        """Fit the whole image into the view."""
        self.is_fitted = True
        self._plate.size = self.size()
        self._plate.fit_view()
        self.invalidate()

    def set_view(self, centre: QPointF, scale: float) -> None:
        """Centre the view on an image pixel, with `scale` screen pixels per image pixel."""
        self.is_fitted = False
        self._plate.centre = centre
        self._plate.scale = min(max(scale, MIN_ZOOM), MAX_ZOOM)
        self.invalidate()

    @property
    def centre(self) -> QPointF:
        """The image pixel at the centre of the view."""
        return QPointF(self._plate.centre)

    @property
    def scale(self) -> float:
        """Screen pixels per image pixel; 0 without an image."""
        return self._plate.scale

    def to_screen(self, at: QPointF) -> QPointF:
        """Return the screen position of a point in image pixels."""
        return self._plate.to_screen(at)

    def to_image(self, at: QPointF) -> QPointF:
        """Return the point in image pixels at a screen position."""
        return self._plate.to_image(at)

    def invalidate(self) -> None:
        """Drop the cached rendering."""
        self._kept = None
        self.update()

    def render_now(self) -> None:
        """Render the image now, so that the next paint event of the window is cheap."""
        if self.isVisible():
            self._put_together()

    def _put_together(self) -> QPixmap:
        dense = self.devicePixelRatioF()
        if self._kept is None or self._kept.devicePixelRatioF() != dense:
            self.n_renders += 1
            self._kept = self._plate.render(dense, get_backdrop(self.palette()), self.font())
        return self._kept

    def resizeEvent(self, a0: Any) -> None:  # noqa: N802
        """Fit a fitted image to the new size; show more of a zoomed one."""
        super().resizeEvent(a0)
        self._plate.size = self.size()
        if self.is_fitted:
            self._plate.fit_view()
        self.invalidate()

    def changeEvent(self, a0: Any) -> None:  # noqa: N802
        """Use the background of the new theme."""
        super().changeEvent(a0)
        if a0.type() == QEvent.Type.PaletteChange:
            self._plate.set_theme(get_theme_colours(self.palette()))
            self.invalidate()

    def paint(self, painter: QPainter, ink: ThemeColours) -> None:
        """Paint the cached rendering and the handle, crosshair, line and marks over it."""
        del ink
        painter.drawPixmap(0, 0, self._put_together())
        if self._plate.image is None:
            return
        if self.handle_share is not None:
            x = self._handle_x()
            painter.setPen(QPen(to_qcolor(CROSSHAIR_COLOUR), 2))
            painter.drawLine(QPointF(x, 0), QPointF(x, self.height()))
            left, right = self.handle_words
            box = measure_tag(painter, left)
            draw_tag(painter, box, QPointF(x - 2 - box.width(), 2), left)
            draw_tag(painter, measure_tag(painter, right), QPointF(x + 2, 2), right)
        if self.crosshair is not None:
            self._draw_cross(painter, *self.crosshair)
        if self.hasFocus():
            painter.setPen(QPen(self.palette().color(QPalette.ColorRole.Highlight), 2))
            painter.setBrush(Qt.BrushStyle.NoBrush)
            painter.drawRect(QRectF(self.rect()).adjusted(1, 1, -1, -1))
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        if self.line is not None:
            self._draw_line(painter, *map(self.to_screen, self.line))
        font = self.font()
        font.setBold(True)
        painter.setFont(font)
        radius = min(max(_MARK_SHARE * self.height(), _MARK_PX[0]), _MARK_PX[1])
        for number, (row, col) in self.marks:
            at = self.to_screen(QPointF(col + 0.5, row + 0.5))
            _draw_badge(painter, at, radius, get_probe_colour(number), str(number))

    def _draw_line(self, painter: QPainter, begin: QPointF, end: QPointF) -> None:
        for colour, wide in ((CASING_COLOUR, 4.0), (SECTION_COLOUR, 1.8)):
            painter.setPen(QPen(to_qcolor(colour), wide))
            painter.drawLine(begin, end)
        way = end - begin
        if math.hypot(way.x(), way.y()) > 6 * _END_PX:
            _draw_badge(painter, begin, _END_PX, SECTION_COLOUR, "A")
            _draw_badge(painter, end, _END_PX, SECTION_COLOUR, "B")
        else:  # in a small image letters would hide the section
            _draw_badge(painter, begin, 0.4 * _END_PX, SECTION_COLOUR)
            _draw_badge(painter, end, 0.4 * _END_PX, CASING_COLOUR)

    def _draw_cross(self, painter: QPainter, row: int, col: int) -> None:
        at = self.to_screen(QPointF(col + 0.5, row + 0.5))
        painter.setPen(QPen(to_qcolor(CROSSHAIR_COLOUR), 1.2))
        painter.drawLine(QPointF(at.x(), 0), QPointF(at.x(), self.height()))
        painter.drawLine(QPointF(0, at.y()), QPointF(self.width(), at.y()))
        if not self.crosshair_text:
            return
        painter.setFont(self.font())
        box = measure_tag(painter, self.crosshair_text)
        left = at.x() + 6 if at.x() + 8 + box.width() < self.width() else at.x() - 6 - box.width()
        top = at.y() + 5 if at.y() + 8 + box.height() < self.height() else at.y() - 5 - box.height()
        place = QPointF(max(1.0, min(left, self.width() - box.width() - 1)), max(1.0, top))
        draw_tag(painter, box, place, self.crosshair_text)

    def mousePressEvent(self, a0: Any) -> None:  # noqa: N802
        """Record where a click or drag begins."""
        at: QPointF = a0.position()
        self._drags_handle = self.is_near_handle(at)
        if not self._drags_handle:
            left = a0.button() == Qt.MouseButton.LeftButton
            self._pressed = at if left else None
            self._dragged = at if left or a0.button() == Qt.MouseButton.MiddleButton else None

    def mouseMoveEvent(self, a0: Any) -> None:  # noqa: N802
        """Drag the overlay's handle, else pan; without a button, emit the position."""
        at: QPointF = a0.position()
        image = self._plate.image
        if self._drags_handle and image is not None:
            self.handle_dragged.emit(self.to_image(at).x() / image.width())
        elif self._dragged is None:
            shapes = Qt.CursorShape
            is_near = self.is_near_handle(at)
            self.setCursor(shapes.SplitHCursor if is_near else shapes.ArrowCursor)
            self.mouse_moved.emit(at)
        elif self._pressed is None or (at - self._pressed).manhattanLength() >= _A_CLICK_PX:
            self.set_view(
                self._plate.centre - (at - self._dragged) / max(self._plate.scale, 1e-3),
                self._plate.scale,
            )
            self._dragged = at
            self.view_changed.emit()

    def mouseReleaseEvent(self, a0: Any) -> None:  # noqa: N802
        """Emit a click for a release close to its press, else end the drag."""
        if (
            self._pressed is not None
            and (a0.position() - self._pressed).manhattanLength() < _A_CLICK_PX
        ):
            self.clicked.emit(a0.position())
        self._pressed = self._dragged = None
        self._drags_handle = False

    def mouseDoubleClickEvent(self, a0: Any) -> None:  # noqa: N802
        """Fit the whole image."""
        del a0
        self.fit_view()
        self.view_changed.emit()

    def wheelEvent(self, a0: Any) -> None:  # noqa: N802
        """Zoom about the pixel under the mouse."""
        if self._plate.image is None or not a0.angleDelta().y():
            return
        at = a0.position()
        fixed = self.to_image(at)
        wanted = self._plate.scale * _ZOOM_STEP ** (a0.angleDelta().y() / _PER_NOTCH)
        if wanted <= self._plate.fitted_scale:  # there is nothing around the sensor to see
            self.fit_view()
        else:
            scale = min(wanted, MAX_ZOOM)
            self.set_view(fixed - (at - QRectF(self.rect()).center()) / scale, scale)
        self.view_changed.emit()

    def leaveEvent(self, a0: Any) -> None:  # noqa: N802
        """Emit that the mouse left."""
        super().leaveEvent(a0)
        self.mouse_left.emit()

    def is_near_handle(self, at: QPointF) -> bool:
        """Return whether the overlay's handle is at a screen position."""
        return self.handle_share is not None and abs(self._handle_x() - at.x()) < _NEAR_PX

    def _handle_x(self) -> float:
        image = self._plate.image
        wide = 0 if image is None else (self.handle_share or 0.0) * image.width()
        return self.to_screen(QPointF(wide, 0.0)).x()


def measure_tag(painter: QPainter, text: str) -> QRectF:
    """Return the box of a text over an image."""
    return QRectF(painter.fontMetrics().boundingRect(text)).adjusted(-4, -1, 4, 2)


def draw_tag(painter: QPainter, box: QRectF, at: QPointF, text: str) -> None:
    """Draw a text over an image in its box, moved to a position."""
    box.moveTopLeft(at)
    painter.setPen(Qt.PenStyle.NoPen)
    painter.setBrush(QColor(20, 24, 30, 205))
    painter.drawRoundedRect(box, 3, 3)
    painter.setPen(QColor(255, 255, 255))
    painter.drawText(box, Qt.AlignmentFlag.AlignCenter, text)


def _draw_badge(painter: QPainter, at: QPointF, radius: float, colour: Rgb, text: str = "") -> None:
    """Draw a disc with a letter."""
    side = QPointF(radius, radius)
    painter.setPen(QPen(to_qcolor(CASING_COLOUR), 1.3))
    painter.setBrush(to_qcolor(colour))
    painter.drawEllipse(at, radius, radius)
    painter.drawText(QRectF(at - side, at + side), Qt.AlignmentFlag.AlignCenter, text)
