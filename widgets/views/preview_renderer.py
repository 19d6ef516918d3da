"""Renders a preview for the screen: fit or zoom, outlines, scale bar, and an overlay."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PyQt6.QtCore import QPointF, QRectF, QSize, QSizeF, Qt
from PyQt6.QtGui import QColor, QFont, QImage, QPainter, QPalette, QPen, QPixmap, QPolygonF

from pipeline.core.arrays import Image
from pipeline.views.colours import NO_VALUE_COLOUR, ColourScale, darken_diverging
from pipeline.views.drawing import Line, list_outlines, make_scale_bar
from pipeline.views.preview import Preview
from widgets.style.theme import (
    LIGHT_COLOURS,
    ThemeColours,
    get_colour_map,
    get_theme_colours,
    to_qcolor,
)

MAX_ZOOM = 60.0
MIN_ZOOM = 0.02
# screen pixels: images without a scale bar; half the room for its text
_NARROWEST_PX = 60.0
_LABEL_PX = 100.0


class PreviewRenderer:
    """Which part of an image is visible at which scale, and its rendering."""

    def __init__(self) -> None:
        self.preview: Preview | None = None
        self.image: QImage | None = None
        # and the share of the width that shows the lower image
        self.overlay: tuple[QImage, float] | None = None
        self._ink = LIGHT_COLOURS
        self._overlay_pixels: Image | None = None  # pixels of the overlay
        # image pixel at the centre; screen pixels per image pixel
        self.centre = QPointF()
        self.scale = 0.0
        self.size = QSize()

    def set_preview(self, picture: Preview | None) -> bool:
        """Set another image, None for no image, and return whether it needs another view than
        the one before.
        """
        old = self.preview
        self.preview = picture
        if picture is None:
            self.image = None
            self.overlay = None
            return False
        self.image = make_qimage(self._recolour(picture.pixels))
        return old is None or old.pixels.shape[:2] != picture.pixels.shape[:2]

    def set_overlay(self, pixels: Image | None, share: float) -> None:
        """Overlay pixels of the same size from this share of the width on; None removes them."""
        self._overlay_pixels = pixels
        self.overlay = None if pixels is None else (make_qimage(self._recolour(pixels)), share)

    def set_theme(self, ink: ThemeColours) -> None:
        """Draw pixels without a value, and signed values, in the colours of a theme."""
        if ink is self._ink:
            return
        self._ink = ink
        if self.preview is not None:
            self.set_preview(self.preview)
        if self.overlay is not None:
            self.set_overlay(self._overlay_pixels, self.overlay[1])

    def _recolour(self, pixels: Image) -> Image:
        scale = None if self.preview is None else self.preview.scale
        return pixels if scale is None else recolour_for_theme(pixels, scale, self._ink)

    def fit_view(self) -> None:
        """Fit the whole image into the view."""
        if self.image is not None:
            self.scale = self.fitted_scale
            self.centre = QPointF(0.5 * self.image.width(), 0.5 * self.image.height())

    @property
    def fitted_scale(self) -> float:
        """Screen pixels per image pixel at which the whole image fits the view.

        0 without an image.
        """
        if self.image is None:
            return 0.0
        wide = self.size.width() / self.image.width()
        return max(1e-3, min(wide, self.size.height() / self.image.height()))

    def to_screen(self, at: QPointF) -> QPointF:
        """Return the screen position of a point in image pixels."""
        return (at - self.centre) * self.scale + self._middle

    def to_image(self, at: QPointF) -> QPointF:
        """Return the point in image pixels at a screen position."""
        return (
            (at - self._middle) / self.scale + self.centre
            if self.scale > 0
            else QPointF(-1.0, -1.0)
        )

    @property
    def _visible_ends(self) -> tuple[QPointF, QPointF]:
        """Upper left and lower right of what is visible, in image pixels."""
        return self.to_image(QPointF()), self.to_image(2 * self._middle)

    @property
    def _middle(self) -> QPointF:
        return QPointF(0.5 * self.size.width(), 0.5 * self.size.height())

    def render(self, dense: float, behind: QColor, font: QFont) -> QPixmap:
        """Return image, outlines and scale bar at `dense` physical pixels per logical pixel."""
        pixmap = QPixmap((dense * QSizeF(self.size)).toSize().expandedTo(QSize(1, 1)))
        pixmap.setDevicePixelRatio(dense)
        pixmap.fill(behind)
        if self.image is None or self.preview is None:
            return pixmap
        painter = QPainter(pixmap)
        self._draw_image(painter, self.image, 0.0, dense)
        if self.overlay is not None:
            self._draw_image(painter, *self.overlay, dense)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        for line in list_outlines(self.preview):
            self._draw_line(painter, line)
        self._draw_scale_bar(painter, self.preview, font)
        painter.end()
        return pixmap

    def _draw_image(
        self, painter: QPainter, image: QImage, from_share: float, dense: float
    ) -> None:
        first = round(from_share * image.width())
        ends = self._visible_ends
        part = QRectF(*ends).toAlignedRect() & image.rect().adjusted(first, 0, 0, 0)
        if part.isEmpty():
            return
        place = QRectF(self.to_screen(QPointF(part.topLeft())), QSizeF(part.size()) * self.scale)
        drawn = image.copy(part)
        if self.scale * dense < 1.0:  # average the image pixels that fall on a screen pixel
            size = (dense * place.size()).toSize().expandedTo(QSize(1, 1))
            ratio = Qt.AspectRatioMode.IgnoreAspectRatio
            how = Qt.TransformationMode.SmoothTransformation
            drawn = drawn.scaled(size, ratio, how)
        painter.drawImage(place, drawn)

    def _draw_line(self, painter: QPainter, line: Line) -> None:
        colour = to_qcolor(line.rgb, round(255 * line.opacity))
        flat = Qt.PenCapStyle.FlatCap
        # a square cap lengthens a scale bar
        painter.setPen(QPen(colour, line.width, Qt.PenStyle.SolidLine, flat))
        first = self.to_screen(QPointF())
        at = line.points_px * self.scale + (first.x(), first.y())
        step = max(1, math.floor(0.7 / self.scale))
        gaps = np.flatnonzero(np.isnan(at[:, 0]))
        for piece in np.split(at, gaps):
            known = piece[~np.isnan(piece[:, 0])]
            if len(known) > 1:
                painter.drawPolyline(to_polygon(np.concatenate([known[:-1:step], known[-1:]])))

    def _draw_scale_bar(self, painter: QPainter, picture: Preview, font: QFont) -> None:
        rows, cols = picture.pixels.shape[:2]
        low, high = self._visible_ends
        visible = max(0.0, low.x()), max(0.0, low.y()), min(cols, high.x()), min(rows, high.y())
        bar = make_scale_bar(picture, visible, self._recolour)
        if bar is None or (visible[2] - visible[0]) * self.scale < _NARROWEST_PX:
            return
        self._draw_line(painter, bar.line)
        # A font of a size in pixels belongs to the size of the whole image.
        painter.setFont(font)
        x, y = bar.line.points_px.mean(axis=0)
        below = self.to_screen(QPointF(x, y)) + QPointF(_LABEL_PX, -3)
        above = below - QPointF(2 * _LABEL_PX, painter.fontMetrics().height())
        painter.drawText(QRectF(above, below), Qt.AlignmentFlag.AlignCenter, bar.text)


def to_polygon(points: NDArray[np.floating]) -> QPolygonF:
    """Convert points (n, 2) to a polygon in one copy; one by one they cost more than painting."""
    polygon = QPolygonF()
    polygon.resize(len(points))
    held: Any = polygon.data()
    held.setsize(len(points) * 2 * 8)
    np.frombuffer(held, np.float64).reshape(-1, 2)[:] = points
    return polygon


def make_qimage(pixels: Image) -> QImage:
    """Convert pixels (rows, cols, 3) uint8 to the image format that Qt paints fastest."""
    rows, cols = pixels.shape[:2]
    image = QImage(pixels.tobytes(), cols, rows, 3 * cols, QImage.Format.Format_RGB888)
    return image.convertToFormat(QImage.Format.Format_RGB32)


def recolour_for_theme(pixels: Image, scale: ColourScale, ink: ThemeColours) -> Image:
    """Return the pixels of a scale in the colours of a theme: pixels without a value, and signed
    values.
    """
    if ink is LIGHT_COLOURS:
        return pixels
    is_same = get_colour_map(ink, scale) == scale.colour_map
    out = (pixels if is_same else darken_diverging(pixels)).copy()
    out[(pixels == NO_VALUE_COLOUR).all(axis=-1)] = ink.no_value  # that grey is in no colour map
    return out


def make_themed_qimage(palette: QPalette, picture: Preview) -> QImage:
    """Return a preview as an image on the background of a palette."""
    return make_qimage(
        picture.pixels
        if picture.scale is None
        else recolour_for_theme(picture.pixels, picture.scale, get_theme_colours(palette))
    )
