"""Presentation: two or three images with their titles over the whole screen, and nothing else."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from PyQt6.QtCore import QPointF, QRectF, QSize, Qt, pyqtSignal
from PyQt6.QtGui import QColor, QFont, QImage, QPainter
from PyQt6.QtWidgets import QWidget

from pipeline.views.colours import ColourScale, get_colour_table
from pipeline.views.preview import Preview
from widgets.style.theme import DARK_COLOURS, get_colour_map
from widgets.views.preview_renderer import PreviewRenderer, make_qimage

_GROUND = QColor(18, 20, 24)
_INK = QColor(232, 235, 240)
# of the height; the gap of the width
_TITLE_SHARE = 0.07
_SCALE_SHARE = 0.08
_GAP_SHARE = 0.012
_LETTERS_SHARE = 0.024  # height of letters, of the height
_BAR_WIDTH_SHARE = 0.5  # of an image's width


@dataclass(frozen=True, slots=True, kw_only=True)
class PresentedPane:
    """One image of a presentation."""

    title: str
    preview: Preview


def compose(panes: Sequence[PresentedPane], size: QSize) -> QImage:
    """Return the panes side by side on an image of this size; safe on any thread."""
    image = QImage(size, QImage.Format.Format_RGB32)
    image.fill(_GROUND)
    painter = QPainter(image)
    painter.setRenderHints(
        QPainter.RenderHint.Antialiasing | QPainter.RenderHint.SmoothPixmapTransform
    )
    font = QFont(painter.font())
    font.setPixelSize(max(9, round(_LETTERS_SHARE * size.height())))
    painter.setFont(font)
    wide = size.width()
    high = size.height()
    gap = _GAP_SHARE * wide
    top = _TITLE_SHARE * high
    foot = _SCALE_SHARE * high
    shares = [pane.preview.pixels.shape[1] / pane.preview.pixels.shape[0] for pane in panes]
    room = wide - gap * (len(panes) + 1)
    # images of one height, as wide as they need
    heights = min(high - top - foot, room / max(sum(shares), 1e-6))
    spare = room - heights * sum(shares)
    left = gap + 0.5 * spare
    above = top + 0.5 * (high - top - foot - heights)
    for pane, share in zip(panes, shares, strict=True):
        place = QRectF(left, above, heights * share, heights)
        _draw_pane(painter, pane, place, top, foot)
        left += place.width() + gap
    painter.end()
    return image


def _draw_pane(
    painter: QPainter, pane: PresentedPane, place: QRectF, top: float, foot: float
) -> None:
    plate = PreviewRenderer()
    plate.set_theme(DARK_COLOURS)
    plate.size = QSize(round(place.width()), round(place.height()))
    plate.set_preview(pane.preview)
    plate.fit_view()
    painter.save()
    painter.translate(place.topLeft())
    painter.setClipRect(QRectF(QPointF(0, 0), place.size()))
    plate.paint(painter, 1.0, painter.font())
    painter.restore()
    painter.setPen(_INK)
    title = QRectF(place.left(), place.top() - top, place.width(), top)
    words = painter.fontMetrics().elidedText(
        pane.title, Qt.TextElideMode.ElideRight, round(title.width())
    )
    painter.drawText(title, Qt.AlignmentFlag.AlignCenter, words)
    if pane.preview.scale is not None:
        _draw_scale(
            painter, pane.preview.scale, QRectF(place.left(), place.bottom(), place.width(), foot)
        )


def _draw_scale(painter: QPainter, scale: ColourScale, room: QRectF) -> None:
    """Draw the colour bar with its limits and unit."""
    wide = _BAR_WIDTH_SHARE * room.width()
    high = 0.2 * room.height()
    bar = QRectF(room.center().x() - 0.5 * wide, room.top() + 0.25 * room.height(), wide, high)
    painter.drawImage(bar, make_qimage(get_colour_table(get_colour_map(DARK_COLOURS, scale))[None]))
    words = QRectF(
        room.left(), bar.bottom(), room.width(), room.height() - (bar.bottom() - room.top())
    )
    painter.drawText(
        words, Qt.AlignmentFlag.AlignCenter, f"{scale.low:g} to {scale.high:g} {scale.unit}"
    )


class PresentationView(QWidget):
    """A window without anything but the images; it keeps the last ones until it gets others."""

    left = pyqtSignal()  # by Esc, or closed

    def __init__(self) -> None:
        super().__init__()
        self.setObjectName("presentation")
        self.setWindowTitle("Tactoscope")
        self.setAttribute(Qt.WidgetAttribute.WA_OpaquePaintEvent)
        self.setCursor(Qt.CursorShape.BlankCursor)
        self.panes: tuple[PresentedPane, ...] = ()
        self._image: QImage | None = None

    def show_panes(self, panes: Sequence[PresentedPane]) -> None:
        """Show other images."""
        self.panes = tuple(panes)
        self._image = None
        self.update()

    def paintEvent(self, a0: Any) -> None:  # noqa: N802
        """Paint the images in the pixels of the screen."""
        del a0
        dense = self.devicePixelRatioF()
        size = QSize(round(dense * self.width()), round(dense * self.height()))
        if self._image is None or self._image.size() != size:
            self._image = compose(self.panes, size)
            self._image.setDevicePixelRatio(dense)
        QPainter(self).drawImage(0, 0, self._image)

    def keyPressEvent(self, a0: Any) -> None:  # noqa: N802
        """Leave by Esc."""
        if a0.key() == Qt.Key.Key_Escape:
            self.left.emit()
        else:
            super().keyPressEvent(a0)

    def closeEvent(self, a0: Any) -> None:  # noqa: N802
        """Leave when the window is closed in another way."""
        super().closeEvent(a0)
        self.left.emit()
