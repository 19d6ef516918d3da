"""A colour bar with its limits, unit and what the colours mean."""

from __future__ import annotations

from PyQt6.QtCore import QRectF, QSize, Qt
from PyQt6.QtGui import QImage, QPainter, QPaintEvent
from PyQt6.QtWidgets import QSizePolicy, QWidget

from pipeline.pictures.colours import ColourScale, table
from widgets.looks import smaller

_STRIP_PX = 8


class ColourBar(QWidget):
    """A horizontal strip with the lowest, middle and highest value under it; empty for pictures in true colour."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._scale: ColourScale | None = None
        self._strip: QImage | None = None
        smaller(self)
        self.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)

    def sizeHint(self) -> QSize:  # noqa: N802
        """Room for the strip and one line of numbers."""
        return QSize(120, _STRIP_PX + self.fontMetrics().height() + 3)

    def show_scale(self, scale: ColourScale | None) -> None:
        """Show the colours and limits of `scale`, nothing for None."""
        if scale == self._scale:
            return
        self._scale = scale
        if scale is not None:
            colours = table(scale.map)
            self._strip = QImage(colours.tobytes(), 256, 1, 3 * 256, QImage.Format.Format_RGB888).copy()
            self.setToolTip(f"{scale.quantity}, {scale.low:g} to {scale.high:g} {scale.unit} (fixed limits)")
        self.update()

    def paintEvent(self, a0: QPaintEvent | None) -> None:  # noqa: N802
        """Draw the strip and its numbers."""
        del a0
        if self._scale is None or self._strip is None:
            return
        scale, painter = self._scale, QPainter(self)
        strip = QRectF(2, 0, self.width() - 4, _STRIP_PX)
        painter.drawImage(strip, self._strip)
        painter.setPen(self.palette().mid().color())
        painter.drawRect(strip)
        painter.setPen(self.palette().text().color())
        row = QRectF(2, _STRIP_PX + 1, self.width() - 4, self.fontMetrics().height() + 2)
        middle = 0.5 * (scale.low + scale.high)
        for text, place in (
            (f"{scale.low:g}", Qt.AlignmentFlag.AlignLeft),
            (f"{middle:g}", Qt.AlignmentFlag.AlignHCenter),
            (f"{scale.high:g} {scale.unit}", Qt.AlignmentFlag.AlignRight),
        ):
            painter.drawText(row, int(place), text)
