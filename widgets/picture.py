"""One stage's picture: pixels, contact outline, scale bar, colour bar, crosshair and what a pixel reads."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from PyQt6.QtCore import QPointF, QSize, Qt, pyqtSignal
from PyQt6.QtWidgets import QBoxLayout, QLabel, QVBoxLayout, QWidget

from pipeline.pictures.picture import Picture
from widgets.canvas import Canvas
from widgets.levels import Levels
from widgets.looks import smaller, spaced
from widgets.still_label import StillLabel
from widgets.wipe import Overlay

BESIDE_PX = 170  # wide are words beside a picture
_AROUND = 1.3  # times the contact that is fitted
_NO_LIMIT = 16_777_215  # of a widget's width, as Qt has it


class PictureView(QWidget):
    """Shows a `Picture`; says which pixel the mouse is over and which was clicked."""

    pixel_hovered = pyqtSignal(int, int)  # row, col; (-1, -1) once the mouse has left
    pixel_clicked = pyqtSignal(int, int)
    shape_changed = pyqtSignal()  # a picture of another size
    scale_changed = pyqtSignal()  # one with a scale after one without, or the other way
    look_changed = pyqtSignal()  # panned or zoomed by hand

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.picture: Picture | None = None  # what is shown
        self._shape: tuple[int, int] | None = None
        self.canvas = Canvas()
        self.overlay = Overlay(self.canvas)
        self.levels = Levels()
        self._caption = StillLabel()
        self._caption.setAlignment(Qt.AlignmentFlag.AlignTop | Qt.AlignmentFlag.AlignLeft)
        self._message = QLabel(self.canvas)
        self._message.setWordWrap(True)
        self._message.setAlignment(Qt.AlignmentFlag.AlignCenter)
        self._message.setAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)
        self._message.setAutoFillBackground(True)
        self._message.hide()
        self.words = QWidget()  # all that is told of the picture
        told = spaced(QVBoxLayout(self.words), 2)
        told.addWidget(self.levels)
        told.addWidget(self._caption)
        told.addStretch(1)
        self._both = spaced(QBoxLayout(QBoxLayout.Direction.TopToBottom, self), 2)
        self._both.addWidget(self.canvas, 1)
        self._both.addWidget(self.words)
        smaller(self._caption)
        self.show_lines(2)
        self.canvas.mouse_moved.connect(self._report_hover)
        self.canvas.mouse_left.connect(lambda: self.pixel_hovered.emit(-1, -1))
        self.canvas.clicked.connect(self._report_click)
        self.canvas.look_changed.connect(self.look_changed)

    def lay_words(self, *, beside: bool) -> None:
        """Put what is told to the right of the picture, or under it."""
        way = QBoxLayout.Direction.LeftToRight if beside else QBoxLayout.Direction.TopToBottom
        if way != self._both.direction():
            self._both.setDirection(way)
            self.words.setFixedWidth(BESIDE_PX) if beside else self.words.setMaximumWidth(_NO_LIMIT)
            self.words.setMinimumWidth(BESIDE_PX if beside else 0)

    def show_lines(self, lines: int) -> None:
        """How many lines the caption has."""
        self._caption.show_lines(lines)

    @property
    def message(self) -> str:
        """The sentence over the picture."""
        return self._message.text()

    @property
    def cross(self) -> tuple[int, int] | None:
        """Where the trace's crosshair is, (row, col)."""
        return self.canvas.cross

    def show_picture(self, picture: Picture) -> None:
        """Show a picture; the view moves only when the number of pixels changed."""
        if picture is self.picture:
            return
        other = self.scaled != (picture.scale is not None)
        self.picture = picture
        self.canvas.show_picture(picture)
        self.levels.show_scale(picture.scale, picture.values)
        self._caption.setText(picture.caption)
        self._caption.setToolTip(picture.caption)
        shape = (picture.pixels.shape[0], picture.pixels.shape[1])
        if shape != self._shape:
            self._shape = shape
            self.shape_changed.emit()
        if other:
            self.scale_changed.emit()

    @property
    def scaled(self) -> bool:
        """Whether the picture has a scale of colours."""
        return self.picture is not None and self.picture.scale is not None

    def show_message(self, text: str) -> None:
        """Lay a sentence over the picture (why it was skipped, or that it is out of date); "" removes it."""
        if text == self._message.text():
            return
        self._message.setText(text)
        self._message.setVisible(bool(text))
        self._place_message()

    def show_dimmed(self, dimmed: bool) -> None:
        """Fade the picture while a newer one is being made."""
        self.canvas.show_dimmed(dimmed)

    def show_cross(self, pixel: tuple[int, int] | None, tag: str = "") -> None:
        """Put the trace's crosshair on (row, col) with what is read there, or take it away."""
        self.canvas.show_cross(pixel, tag)

    @property
    def room_px(self) -> QSize:
        """What the picture itself has of the widget."""
        return self.canvas.size()

    @property
    def tall(self) -> float:
        """Rows over columns of the picture, that of a camera's usual picture while there is none."""
        return self._shape[0] / self._shape[1] if self._shape is not None else 0.75

    def reset_view(self) -> None:
        """Fit the whole picture."""
        self.canvas.fit()

    def fit_to(self, box_px: tuple[float, float, float, float]) -> None:
        """Fit a part of the picture, given by its left, top, right and lower end in pixels, with some room around."""
        left, top, right, below = box_px
        room = self.canvas.size()
        wide, high = max(right - left, 4.0) * _AROUND, max(below - top, 4.0) * _AROUND
        scale = min(room.width() / wide, room.height() / high)
        self.canvas.look(QPointF(0.5 * (left + right), 0.5 * (top + below)), scale)

    def contact_box_px(self) -> tuple[float, float, float, float] | None:
        """Left, top, right and lower end of the contact's outline; None without one."""
        border = None if self.picture is None else self.picture.outline_px
        if border is None or not np.isfinite(border).any():
            return None
        (left, top), (right, below) = np.nanmin(border, axis=0), np.nanmax(border, axis=0)
        return float(left), float(top), float(right), float(below)

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
        room = self.canvas.size()
        width = max(60, room.width() - 12)
        height = min(room.height() - 8, max(20, self._message.heightForWidth(width) + 4))
        self._message.setGeometry((room.width() - width) // 2, (room.height() - height) // 2, width, height)

    def _pixel_at(self, place: QPointF) -> tuple[int, int] | None:
        point = self.canvas.to_picture(place)
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
