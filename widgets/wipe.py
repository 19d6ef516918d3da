"""A second picture over a column's own: up to a handle that is dragged, or in turns with it."""

from __future__ import annotations

from typing import Any

import pyqtgraph as pg
from PyQt6.QtCore import QObject, QRectF, Qt, QTimer

from pipeline.pictures.picture import Picture
from widgets.colours import TRACE, qcolor

_BLINK_MS = 500  # two pictures a second


class Overlay(QObject):
    """Lies in a picture's view box; shows nothing until it is given a picture of the same size."""

    def __init__(self, box: Any, parent: QObject) -> None:
        super().__init__(parent)
        self._image = pg.ImageItem(axisOrder="row-major")
        self.handle: Any = pg.InfiniteLine(angle=90, movable=True, pen=pg.mkPen(qcolor(TRACE), width=2))
        self.handle.setHoverPen(pg.mkPen(qcolor(TRACE), width=4))
        self.handle.setCursor(Qt.CursorShape.SplitHCursor)
        for item in (self._image, self.handle):
            box.addItem(item, ignoreBounds=True)
            item.hide()
        self._picture: Picture | None = None
        self._share = 0.5  # of the width that is left to the picture below
        self._blink = QTimer(self)
        self._blink.setInterval(_BLINK_MS)
        self._blink.timeout.connect(lambda: self._image.setVisible(not self._image.isVisible()))
        self.handle.sigPositionChanged.connect(self._dragged)

    @property
    def shown(self) -> bool:
        """Whether the second picture can be seen now."""
        return bool(self._image.isVisible())

    def show_none(self) -> None:
        """Take the second picture away."""
        self._picture = None
        self._blink.stop()
        self._image.hide()
        self.handle.hide()

    def show_wiped(self, picture: Picture) -> None:
        """The second picture right of the handle, which stays where it was dragged to."""
        self._blink.stop()
        self._picture = picture
        width = picture.pixels.shape[1]
        self.handle.setBounds((0, width))
        self.handle.show()
        self.handle.setValue(self._share * width)
        self._cut()

    def show_blinking(self, picture: Picture) -> None:
        """The second picture in turns with the one below."""
        self._picture = picture
        self.handle.hide()
        self._place(0)
        if not self._blink.isActive():
            self._blink.start()

    def _dragged(self) -> None:
        if self._picture is not None and self.handle.isVisible():
            self._share = float(self.handle.value()) / self._picture.pixels.shape[1]
            self._cut()

    def _cut(self) -> None:
        if self._picture is not None:
            self._place(round(self._share * self._picture.pixels.shape[1]))

    def _place(self, first: int) -> None:
        assert self._picture is not None
        rows, cols = self._picture.pixels.shape[:2]
        self._image.setVisible(first < cols)
        if first < cols:
            self._image.setImage(self._picture.pixels[:, first:], autoLevels=False, levels=(0, 255))
            self._image.setRect(QRectF(first, 0, cols - first, rows))
