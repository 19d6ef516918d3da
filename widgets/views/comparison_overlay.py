"""Overlay of a second image on a column's own: wipe with a handle, or blink."""

from PyQt6.QtCore import QObject, QTimer

from pipeline.views.preview import Preview
from widgets.views.canvas import Canvas

_BLINK_MS = 500  # two images per second


class ComparisonOverlay(QObject):
    """Lives in a canvas; shows nothing until it gets an image of the same size."""

    def __init__(self, canvas: Canvas) -> None:
        super().__init__(canvas)
        self._canvas = canvas
        self._picture: Preview | None = None
        self.share = 0.5  # share of the width that shows the lower image
        self.is_visible = False  # whether any part of the overlay is visible
        self.blink_timer = QTimer(self)
        self.blink_timer.setInterval(_BLINK_MS)
        self.blink_timer.timeout.connect(self._turn)
        canvas.handle_dragged.connect(self.move_handle)

    def clear(self) -> None:
        """Remove the overlay."""
        if self._picture is None:
            return
        self._picture = None
        self._canvas.handle_share = None
        self.is_visible = False
        self.blink_timer.stop()
        self._canvas.show_overlay(None)

    def show_wipe(self, picture: Preview, left: str = "result", right: str = "truth") -> None:
        """Show the overlay right of the handle, which keeps its position, between two words."""
        self._canvas.handle_words = left, right
        self.blink_timer.stop()
        if picture is not self._picture or not self.is_visible:
            self._picture = picture
            self._canvas.show_overlay(picture.pixels, self.share)
        self.move_handle(self.share)

    def show_blink(self, picture: Preview) -> None:
        """Alternate the overlay with the image below."""
        self._picture = picture
        self._canvas.handle_share = None
        self._place(shown=True)
        if not self.blink_timer.isActive():
            self.blink_timer.start()

    def move_handle(self, share: float) -> None:
        """Move the handle to a share of the width, clipped to the image."""
        self.share = min(max(share, 0.0), 1.0)
        self._canvas.handle_share = self.share
        self._canvas.move_overlay(self.share)
        self.is_visible = self._picture is not None and self.share < 1.0

    def _turn(self) -> None:
        if self._canvas.isVisible():
            self._place(shown=not self.is_visible)

    def _place(self, *, shown: bool) -> None:
        self.is_visible = shown
        assert self._picture is not None
        self._canvas.show_overlay(self._picture.pixels if shown else None)
