"""A second picture over a column's own: up to a handle that is dragged, or in turns with it."""

from __future__ import annotations

from PyQt6.QtCore import QEvent, QObject, QTimer
from PyQt6.QtGui import QMouseEvent

from pipeline.previews.preview import Preview
from widgets.canvas import Canvas

_BLINK_MS = 500  # two pictures a second


class ComparisonOverlay(QObject):
    """Lies in a picture's canvas; shows nothing until it is given a picture of the same size."""

    def __init__(self, canvas: Canvas) -> None:
        super().__init__(canvas)
        self._canvas = canvas
        self._picture: Preview | None = None
        self.share = 0.5  # of the width that is left to the picture below
        self.is_visible = False  # whether any of the second picture can be seen now
        self._held = False  # the handle, by the mouse
        self._blink = QTimer(self)
        self._blink.setInterval(_BLINK_MS)
        self._blink.timeout.connect(self._turn)
        canvas.installEventFilter(self)

    @property
    def is_blinking(self) -> bool:
        """Whether the two pictures come in turns."""
        return self._blink.isActive()

    def clear(self) -> None:
        """Take the second picture away."""
        if self._picture is None:
            return
        self._picture, self._canvas.handle_share, self.is_visible = None, None, False
        self._blink.stop()
        self._canvas.show_overlay(None)

    def show_wipe(self, picture: Preview) -> None:
        """The second picture right of the handle, which stays where it was dragged to."""
        self._blink.stop()
        if picture is not self._picture or not self.is_visible:
            self._picture = picture
            self._canvas.show_overlay(picture.pixels, self.share)
        self.move_handle(self.share)

    def show_blink(self, picture: Preview) -> None:
        """The second picture in turns with the one below."""
        self._picture, self._canvas.handle_share = picture, None
        self._place(shown=True)
        if not self._blink.isActive():
            self._blink.start()

    def move_handle(self, share: float) -> None:
        """Put the handle at this share of the width, no farther than the picture."""
        self.share = min(max(share, 0.0), 1.0)
        self._canvas.handle_share = self.share
        self._canvas.move_overlay(self.share)
        self.is_visible = self._picture is not None and self.share < 1.0

    def eventFilter(self, a0: QObject | None, a1: QEvent | None) -> bool:  # noqa: N802
        """The handle is dragged before the picture is."""
        if self._canvas.handle_share is None or self._picture is None or not isinstance(a1, QMouseEvent):
            return super().eventFilter(a0, a1)
        if a1.type() == QEvent.Type.MouseButtonPress and self._canvas.is_near_handle(a1.position()):
            self._held = True
            return True
        if a1.type() == QEvent.Type.MouseButtonRelease and self._held:
            self._held = False
            return True
        if a1.type() == QEvent.Type.MouseMove and self._held:
            self.move_handle(self._canvas.to_image(a1.position()).x() / self._picture.pixels.shape[1])
            return True
        return super().eventFilter(a0, a1)

    def _turn(self) -> None:
        if self._canvas.isVisible():
            self._place(shown=not self.is_visible)

    def _place(self, *, shown: bool) -> None:
        self.is_visible = shown
        assert self._picture is not None
        self._canvas.show_overlay(self._picture.pixels if shown else None)
