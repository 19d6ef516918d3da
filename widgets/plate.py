"""A picture as it lies on the screen: fitted or zoomed, with outlines, a scale bar and a second picture over it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PyQt6.QtCore import QPointF, QRect, QRectF, QSize, QSizeF, Qt
from PyQt6.QtGui import QColor, QFont, QImage, QPainter, QPalette, QPen, QPixmap, QPolygonF

from pipeline.base.arrays import Floats, Image
from pipeline.pictures.colours import NO_VALUE, Rgb
from pipeline.pictures.picture import Picture
from widgets.colours import CONTACT, FELT, FELT_CASING, inks, qcolor

MOST_ZOOM, LEAST_ZOOM = 60.0, 0.02
_BAR_LENGTHS_MM = (50.0, 20.0, 10.0, 5.0, 2.0, 1.0, 0.5, 0.2, 0.1)
_DIMMED = 0.45
_LETTERS_PT = 7.5


class Plate:
    """Which part of a picture is seen at which size, and the drawing of it; pictures are of one size at a time."""

    def __init__(self) -> None:
        self.picture: Picture | None = None
        self.image: QImage | None = None
        self.second: tuple[QImage, float] | None = None  # and the share of the width that is left to the first
        self.no_value: Rgb = NO_VALUE  # what pixels without a value look like here
        self._beside: Image | None = None  # the second's pixels
        self.dimmed = False
        self.centre, self.scale = QPointF(), 0.0  # picture pixel in the middle; screen pixels a picture pixel
        self.room = QSize()

    def take(self, picture: Picture) -> bool:
        """Draw another picture from now on; whether it has another size."""
        old, self.picture = self.picture, picture
        self.image = image_of(self._grounded(picture.pixels))
        return old is None or old.pixels.shape[:2] != picture.pixels.shape[:2]

    def take_second(self, pixels: Image | None, share: float) -> None:
        """Lay pixels of the same size over it from this share of the width on; None takes them away."""
        self._beside = pixels
        self.second = None if pixels is None else (image_of(self._grounded(pixels)), share)

    def take_ground(self, no_value: Rgb) -> None:
        """Show pixels without a value in another colour from now on."""
        if no_value == self.no_value:
            return
        self.no_value = no_value
        if self.picture is not None:
            self.take(self.picture)
        if self.second is not None:
            self.take_second(self._beside, self.second[1])

    def _grounded(self, pixels: Image) -> Image:
        coloured = self.picture is not None and self.picture.scale is None
        return pixels if coloured else grounded(pixels, self.no_value)

    def fit(self) -> None:
        """The whole picture, as large as there is room."""
        if self.image is not None:
            cols, rows = self.image.width(), self.image.height()
            self.scale = max(1e-3, min(self.room.width() / cols, self.room.height() / rows))
            self.centre = QPointF(0.5 * cols, 0.5 * rows)

    def to_screen(self, at: QPointF) -> QPointF:
        """Where a point of the picture, in its pixels, is drawn."""
        return (at - self.centre) * self.scale + self._middle

    def to_picture(self, at: QPointF) -> QPointF:
        """The point of the picture that is drawn here."""
        return (at - self._middle) / self.scale + self.centre if self.scale > 0 else QPointF(-1.0, -1.0)

    @property
    def _middle(self) -> QPointF:
        return QPointF(0.5 * self.room.width(), 0.5 * self.room.height())

    def drawn(self, dense: float, behind: QColor, font: QFont) -> QPixmap:
        """All of it, at `dense` pixels of the screen's for each of ours."""
        pixmap = QPixmap(max(1, round(dense * self.room.width())), max(1, round(dense * self.room.height())))
        pixmap.setDevicePixelRatio(dense)
        pixmap.fill(behind)
        if self.image is None or self.picture is None:
            return pixmap
        painter = QPainter(pixmap)
        painter.setOpacity(_DIMMED if self.dimmed else 1.0)
        self._draw_image(painter, self.image, 0.0, dense)
        if self.second is not None:
            self._draw_image(painter, *self.second, dense)
        painter.setOpacity(1.0)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        felt, own = self.picture.felt_px, self.picture.outline_px
        casing, inner, rim = (QPen(c, w) for c, w in (
            (qcolor(FELT_CASING, 190), 3.4), (qcolor(FELT), 1.6), (qcolor(CONTACT), 1.6)
        ))  # fmt: skip
        for border, pen in ((felt, casing), (felt, inner), (own, rim)):
            self._draw_border(painter, border, pen)
        self._draw_scale_bar(painter, self.picture, font)
        painter.end()
        return pixmap

    def _draw_image(self, painter: QPainter, image: QImage, from_share: float, dense: float) -> None:
        first = round(from_share * image.width())
        ends = self.to_picture(QPointF(0, 0)), self.to_picture(QPointF(self.room.width(), self.room.height()))
        left, top = max(first, math.floor(ends[0].x())), max(0, math.floor(ends[0].y()))
        right, below = min(image.width(), math.ceil(ends[1].x())), min(image.height(), math.ceil(ends[1].y()))
        if left >= right or top >= below:
            return
        part = QRect(left, top, right - left, below - top)
        place = QRectF(self.to_screen(QPointF(left, top)), QSizeF(part.width(), part.height()) * self.scale)
        drawn = image.copy(part)
        if self.scale * dense < 1.0:  # the mean of what falls on a pixel, not one of it
            size = QSize(max(1, round(dense * place.width())), max(1, round(dense * place.height())))
            ratio, how = Qt.AspectRatioMode.IgnoreAspectRatio, Qt.TransformationMode.SmoothTransformation
            drawn = drawn.scaled(size, ratio, how)
        painter.drawImage(place, drawn)

    def _draw_border(self, painter: QPainter, border_px: Floats | None, pen: QPen) -> None:
        if border_px is None or not len(border_px):
            return
        painter.setPen(pen)
        middle, centre = self._middle, self.centre
        at = (border_px - (centre.x(), centre.y())) * self.scale + (middle.x(), middle.y())
        step = max(1, math.floor(0.7 / self.scale))
        gaps = np.flatnonzero(np.isnan(at[:, 0]))
        for piece in np.split(at, gaps):
            known = piece[~np.isnan(piece[:, 0])]
            if len(known) > 1:
                painter.drawPolyline(_polygon(np.concatenate([known[:-1:step], known[-1:]])))

    def _draw_scale_bar(self, painter: QPainter, picture: Picture, font: QFont) -> None:
        if not (math.isfinite(picture.pixel_mm) and picture.pixel_mm > 0):
            return
        rows, cols = picture.pixels.shape[:2]
        low, high = self.to_screen(QPointF(0, 0)), self.to_screen(QPointF(cols, rows))
        right, below = min(high.x(), self.room.width()), min(high.y(), self.room.height())
        wide = right - max(0.0, low.x())
        px_of_mm = self.scale / picture.pixel_mm
        length_mm = next((n for n in _BAR_LENGTHS_MM if n * px_of_mm <= 0.3 * wide), 0.0)
        if not length_mm or wide < 60:
            return
        end, y = right - 0.05 * wide, below - 8.0
        dark = self._grounded(picture.pixels[-(rows // 6) :: 3, -(cols // 3) :: 3]).mean() < 130
        ink = QColor(255, 255, 255) if dark else QColor(30, 32, 36)
        painter.setPen(QPen(ink, 3))
        painter.drawLine(QPointF(end - length_mm * px_of_mm, y), QPointF(end, y))
        small = QFont(font)
        small.setPointSizeF(_LETTERS_PT)
        painter.setFont(small)
        room = QRectF(end - length_mm * px_of_mm - 40, y - 18, length_mm * px_of_mm + 80, 15)
        painter.drawText(room, Qt.AlignmentFlag.AlignCenter, f"{length_mm:g} mm")


def _polygon(points: NDArray[np.floating]) -> QPolygonF:
    """Points (n, 2) for Qt, copied as a whole: one by one they cost more than drawing them."""
    polygon = QPolygonF()
    polygon.resize(len(points))
    held: Any = polygon.data()
    held.setsize(len(points) * 2 * 8)
    np.frombuffer(held, np.float64).reshape(-1, 2)[:] = points
    return polygon


def image_of(pixels: Image) -> QImage:
    """Pixels (rows, cols, 3) uint8 as Qt draws them fastest."""
    rows, cols = pixels.shape[:2]
    held = pixels.tobytes()
    return QImage(held, cols, rows, 3 * cols, QImage.Format.Format_RGB888).convertToFormat(QImage.Format.Format_RGB32)


def grounded(pixels: Image, no_value: Rgb) -> Image:
    """The same with another colour where there is no value: that grey is in no map."""
    if no_value == NO_VALUE:
        return pixels
    out = pixels.copy()
    out[(pixels == NO_VALUE).all(axis=-1)] = no_value
    return out


def image_under(palette: QPalette, picture: Picture) -> QImage:
    """A picture by itself, on the ground of a palette."""
    return image_of(picture.pixels if picture.scale is None else grounded(picture.pixels, inks(palette).no_value))
