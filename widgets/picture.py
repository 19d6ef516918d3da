"""One stage's picture: pixels, contact outline, scale bar, colour bar, crosshair and what a pixel reads."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pyqtgraph as pg
from PyQt6.QtCore import QPointF, QRectF, QSize, Qt, pyqtSignal
from PyQt6.QtGui import QFont
from PyQt6.QtWidgets import QLabel, QSizePolicy, QVBoxLayout, QWidget

from pipeline.base.arrays import Floats
from pipeline.pictures.picture import Picture
from widgets.colour_bar import ColourBar
from widgets.colours import BACKDROP, CONTACT, FELT, FELT_CASING, TRACE, qcolor
from widgets.looks import smaller, spaced
from widgets.wipe import Overlay

_BAR_LENGTHS_MM = (50.0, 20.0, 10.0, 5.0, 2.0, 1.0, 0.5, 0.2)


class PictureView(QWidget):
    """Shows a `Picture`; says which pixel the mouse is over and which was clicked."""

    pixel_hovered = pyqtSignal(int, int)  # row, col; (-1, -1) once the mouse has left
    pixel_clicked = pyqtSignal(int, int)
    shape_changed = pyqtSignal()  # a picture of another size

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.picture: Picture | None = None  # what is shown
        self._shape: tuple[int, int] | None = None
        self._view = _Canvas()
        self.box: Any = pg.ViewBox(lockAspect=True, invertY=True, enableMenu=False, border=None)
        self.box.setDefaultPadding(0.0)
        self._view.setCentralItem(self.box)
        self._build_items()
        self._bar = ColourBar()
        self._caption = QLabel()
        self._caption.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)
        self._caption.setWordWrap(True)
        self._caption.setAlignment(Qt.AlignmentFlag.AlignTop | Qt.AlignmentFlag.AlignLeft)
        self._message = QLabel(self._view)
        self._message.setWordWrap(True)
        self._message.setAlignment(Qt.AlignmentFlag.AlignCenter)
        self._message.setAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)
        self._message.setStyleSheet("background: rgba(255, 255, 255, 215); border-radius: 4px; padding: 4px;")
        self._message.hide()
        layout = spaced(QVBoxLayout(self), 2)
        layout.addWidget(self._view, 1)
        layout.addWidget(self._bar)
        layout.addWidget(self._caption)
        smaller(self._caption)
        self._caption.setFixedHeight(2 * self._caption.fontMetrics().lineSpacing() + 3)
        self._view.mouse_moved.connect(self._report_hover)
        self._view.mouse_left.connect(lambda: self.pixel_hovered.emit(-1, -1))
        self._view.clicked.connect(self._report_click)

    def _build_items(self) -> None:
        self._image = pg.ImageItem(axisOrder="row-major")
        self._outline = pg.PlotCurveItem(pen=pg.mkPen(qcolor(CONTACT), width=1.6), connect="finite")
        self._felt_casing = pg.PlotCurveItem(pen=pg.mkPen(qcolor(FELT_CASING, 190), width=3.4), connect="finite")
        self._felt = pg.PlotCurveItem(pen=pg.mkPen(qcolor(FELT), width=1.6), connect="finite")
        self._bar_line = pg.PlotCurveItem()
        self._bar_text = pg.TextItem("", anchor=(0.5, 1.0))
        font = QFont()
        font.setPointSizeF(7.5)
        self._bar_text.setFont(font)
        pen = pg.mkPen(qcolor(TRACE), width=1.2)
        self._cross_x, self._cross_y = pg.InfiniteLine(angle=90, pen=pen), pg.InfiniteLine(angle=0, pen=pen)
        lines = (self._felt_casing, self._felt, self._outline, self._bar_line)
        self.box.addItem(self._image, ignoreBounds=True)
        self.overlay = Overlay(self.box, self)
        for item in (*lines, self._bar_text, self._cross_x, self._cross_y):
            self.box.addItem(item, ignoreBounds=True)
        self.show_cross(None)

    @property
    def message(self) -> str:
        """The sentence over the picture."""
        return self._message.text()

    def show_picture(self, picture: Picture) -> None:
        """Show a picture; the view moves only when the number of pixels changed."""
        if picture is self.picture:
            return
        self.picture = picture
        self._image.setImage(picture.pixels, autoLevels=False, levels=(0, 255))
        _draw_border(self._outline, picture.outline_px)
        for curve in (self._felt_casing, self._felt):
            _draw_border(curve, picture.felt_px)
        self._bar.show_scale(picture.scale)
        self._caption.setText(picture.caption)
        self._caption.setToolTip(picture.caption)
        shape = (picture.pixels.shape[0], picture.pixels.shape[1])
        if shape != self._shape:
            self._shape = shape
            self.reset_view()
            self.shape_changed.emit()
        self._place_scale_bar(picture)

    def show_message(self, text: str) -> None:
        """Lay a sentence over the picture (why it was skipped, or that it is out of date); "" removes it."""
        self._message.setText(text)
        self._message.setVisible(bool(text))
        self._place_message()

    def show_dimmed(self, dimmed: bool) -> None:
        """Fade the picture while a newer one is being made."""
        self._image.setOpacity(0.45 if dimmed else 1.0)

    def show_cross(self, pixel: tuple[int, int] | None) -> None:
        """Put the trace's crosshair on (row, col), or take it away."""
        self.cross = pixel  # where the trace's crosshair is
        for line in (self._cross_x, self._cross_y):
            line.setVisible(pixel is not None)
        if pixel is not None:
            self._cross_x.setPos(pixel[1] + 0.5)
            self._cross_y.setPos(pixel[0] + 0.5)

    @property
    def room_px(self) -> QSize:
        """What the picture itself has of the widget."""
        return self._view.size()

    @property
    def tall(self) -> float:
        """Rows over columns of the picture, that of a camera's usual picture while there is none."""
        return self._shape[0] / self._shape[1] if self._shape is not None else 0.75

    def reset_view(self) -> None:
        """Fit the whole picture."""
        if self._shape is not None:
            rows, cols = self._shape
            self.box.setRange(QRectF(0, 0, cols, rows), padding=0.0)

    def resizeEvent(self, a0: Any) -> None:  # noqa: N802
        """Keep the message in the middle."""
        super().resizeEvent(a0)
        self._place_message()

    def sizeHint(self) -> QSize:  # noqa: N802
        """A column's share of a laptop screen."""
        return QSize(200, 220)

    def _place_message(self) -> None:
        if self._message.isHidden():
            return
        room = self._view.size()
        width = max(60, room.width() - 12)
        height = min(room.height() - 8, max(20, self._message.heightForWidth(width) + 4))
        self._message.setGeometry((room.width() - width) // 2, (room.height() - height) // 2, width, height)

    def _place_scale_bar(self, picture: Picture) -> None:
        rows, cols = picture.pixels.shape[:2]
        shown = bool(math.isfinite(picture.pixel_mm) and picture.pixel_mm > 0)
        self._bar_line.setVisible(shown)
        self._bar_text.setVisible(shown)
        if not shown:
            return
        width_mm = cols * picture.pixel_mm
        length_mm = next((n for n in _BAR_LENGTHS_MM if n <= 0.3 * width_mm), _BAR_LENGTHS_MM[-1])
        right, y = 0.95 * cols, 0.95 * rows
        left = right - length_mm / picture.pixel_mm
        self._bar_line.setData(x=np.array([left, right]), y=np.array([y, y]))
        dark = picture.pixels[-(rows // 6) :, -(cols // 3) :].mean() < 130
        ink = (255, 255, 255) if dark else (30, 32, 36)
        self._bar_line.setPen(pg.mkPen(ink, width=3))
        self._bar_text.setText(f"{length_mm:g} mm", color=ink)
        self._bar_text.setPos(0.5 * (left + right), y - 0.02 * rows)

    def _pixel_at(self, place: QPointF) -> tuple[int, int] | None:
        point = self.box.mapSceneToView(self._view.mapToScene(place.toPoint()))
        row, col = math.floor(point.y()), math.floor(point.x())
        if self._shape is None or not (0 <= row < self._shape[0] and 0 <= col < self._shape[1]):
            return None
        return row, col

    def _report_hover(self, place: QPointF) -> None:
        row, col = self._pixel_at(place) or (-1, -1)
        self.pixel_hovered.emit(row, col)

    def _report_click(self, place: QPointF) -> None:
        pixel = self._pixel_at(place)
        if pixel is not None:
            self.pixel_clicked.emit(*pixel)


def _draw_border(curve: Any, border_px: Floats | None) -> None:
    if border_px is None or len(border_px) == 0:
        curve.setData(x=[], y=[])
    else:
        curve.setData(x=border_px[:, 0], y=border_px[:, 1])


class _Canvas(pg.GraphicsView):  # pyright: ignore[reportUntypedBaseClass]
    """A graphics view that tells where the mouse is, and a click from the end of a drag."""

    mouse_moved = pyqtSignal(QPointF)
    mouse_left = pyqtSignal()
    clicked = pyqtSignal(QPointF)

    def __init__(self) -> None:
        super().__init__()
        self.setBackground(qcolor(BACKDROP))
        self._pressed: QPointF | None = None
        self.setMinimumSize(60, 60)
        self.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Expanding)

    def mouseMoveEvent(self, ev: Any) -> None:  # noqa: N802
        """Pass on, and report."""
        super().mouseMoveEvent(ev)
        self.mouse_moved.emit(ev.position())

    def leaveEvent(self, ev: Any) -> None:  # noqa: N802
        """Report that the mouse is elsewhere."""
        super().leaveEvent(ev)
        self.mouse_left.emit()

    def mousePressEvent(self, ev: Any) -> None:  # noqa: N802
        """Remember where a click began."""
        super().mousePressEvent(ev)
        self._pressed = ev.position() if ev.button() == Qt.MouseButton.LeftButton else None

    def mouseReleaseEvent(self, ev: Any) -> None:  # noqa: N802
        """A release near the press is a click, one far from it the end of a drag."""
        super().mouseReleaseEvent(ev)
        if self._pressed is not None and (ev.position() - self._pressed).manhattanLength() < 4:
            self.clicked.emit(ev.position())
        self._pressed = None
