"""Magnifier: the pixels around the cursor, enlarged and with their values, in a corner of the
image.
"""

import math

from PyQt6.QtCore import QRectF, Qt
from PyQt6.QtGui import QColor, QPainter, QPen, qGray
from PyQt6.QtWidgets import QWidget

from pipeline.views.preview import Preview
from widgets.style.base import PaintedWidget
from widgets.style.theme import CROSSHAIR_COLOUR, ThemeColours, to_qcolor
from widgets.views.canvas import Canvas

MAX_RADIUS_PX = 3  # pixels on either side, fewer in a small image
_SHARE = 0.5  # share of the image that may be covered
# that a cell has room for; margin to the image's edge
_WIDEST_VALUE = "-0.00"
_LINE_PX = 3
_DARK = 140  # of 255: text on darker pixels is light


class Magnifier(PaintedWidget):
    """Shows a patch of one image at a time; transparent for the mouse."""

    def __init__(self, parent: QWidget) -> None:
        super().__init__("magnifier", "values around the pixel")
        self.setParent(parent)
        self.setAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)
        metrics = self.fontMetrics()
        self._cell_px = metrics.horizontalAdvance(_WIDEST_VALUE) + 2, metrics.height() + 2
        self.radius_px = MAX_RADIUS_PX
        self.preview: Preview | None = None
        self.centre_pixel = 0, 0  # row, col of the central pixel
        self.hide()

    def show_pixel(self, canvas: Canvas, picture: Preview, row: int, col: int) -> None:
        """Show the surroundings of a pixel in the corner of its canvas that is farthest from it."""
        self.preview = picture
        self.centre_pixel = (row, col)
        if self.parentWidget() is not canvas:
            self.setParent(canvas)
        wide, high = self._cell_px
        room = min(_SHARE * canvas.width() / wide, _SHARE * canvas.height() / high)
        self.radius_px = min(MAX_RADIUS_PX, max(1, int(0.5 * (room - 1.0))))
        self.resize((2 * self.radius_px + 1) * wide + 2, (2 * self.radius_px + 1) * high + 2)
        rows, cols = picture.pixels.shape[:2]
        place = canvas.rect().adjusted(_LINE_PX, _LINE_PX, -_LINE_PX, -_LINE_PX)
        around = self.rect()
        around.moveTopLeft(place.topLeft())
        if row < 0.5 * rows:
            around.moveBottom(place.bottom())
        if col < 0.5 * cols:
            around.moveRight(place.right())
        self.setGeometry(around)
        self.show()
        self.raise_()
        self.update()

    def format_value(self, row: int, col: int) -> str:
        """Return the value of a pixel as text: mm with two digits, or the mean grey level.

        "" if there is none.
        """
        picture = self.preview
        if picture is None or not (
            0 <= row < picture.pixels.shape[0] and 0 <= col < picture.pixels.shape[1]
        ):
            return ""
        if picture.values is None:
            return f"{float(picture.pixels[row, col].mean()):.0f}"
        value = float(picture.values[row, col])
        return f"{value:.2f}" if math.isfinite(value) else "\N{MIDDLE DOT}"

    def paint(self, painter: QPainter, ink: ThemeColours) -> None:
        """Paint one cell per pixel, with a frame around the central one."""
        del ink
        if self.preview is None:
            return
        wide, high = self._cell_px
        pixels, reach = self.preview.pixels, self.radius_px
        painter.fillRect(self.rect(), QColor(20, 24, 30))
        for i in range(-reach, reach + 1):
            for j in range(-reach, reach + 1):
                row, col = self.centre_pixel[0] + i, self.centre_pixel[1] + j
                text = self.format_value(row, col)
                if text:
                    cell = QRectF(1 + (reach + j) * wide, 1 + (reach + i) * high, wide, high)
                    ground = QColor(*pixels[row, col].tolist())
                    painter.fillRect(cell, ground)
                    is_dark = qGray(ground.rgb()) < _DARK
                    painter.setPen(QColor(255, 255, 255) if is_dark else QColor(20, 24, 30))
                    painter.drawText(cell, Qt.AlignmentFlag.AlignCenter, text)
        painter.setPen(QPen(to_qcolor(CROSSHAIR_COLOUR), 2))
        painter.drawRect(QRectF(1 + reach * wide, 1 + reach * high, wide, high))
