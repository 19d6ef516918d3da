"""A stage's preview: pixels, contact outline, scale bar, colour bar, crosshair and pixel value."""

import math

import numpy as np
from PyQt6.QtCore import QEvent, QPointF, QSize, Qt, pyqtSignal
from PyQt6.QtWidgets import QBoxLayout, QWidget

from pipeline.views.preview import Preview
from widgets.style.base import EventListener, FixedSizeLabel
from widgets.style.styling import fill, make_column, make_text, set_spacing
from widgets.views.canvas import Canvas
from widgets.views.colour_bar import ColourBar
from widgets.views.comparison_overlay import ComparisonOverlay

SIDE_TEXT_PX = 180  # width of text next to an image
_AROUND = 1.3  # margin around a fitted contact, as a factor
_NO_LIMIT = 16_777_215  # Qt's maximum widget width


class PreviewView(QWidget):
    """Shows a `Preview`; emits the pixel under the mouse and clicks."""

    pixel_hovered = pyqtSignal(int, int)  # row, col; (-1, -1) after the mouse has left
    pixel_clicked = pyqtSignal(int, int)
    shape_changed = pyqtSignal()  # an image of another shape, or a colour scale comes or goes
    view_changed = pyqtSignal()  # panned or zoomed by the user

    def __init__(self) -> None:
        super().__init__()
        self.preview: Preview | None = None  # what is shown
        # rows over columns of the image, or of a typical camera while there is none
        self.height_over_width = 0.75
        self.canvas = Canvas()
        self.overlay = ComparisonOverlay(self.canvas)
        self.colour_bar = ColourBar()
        # under the caption a remark, where there is something to say
        self.caption, self.remark = FixedSizeLabel(), FixedSizeLabel()
        for label in (self.caption, self.remark):
            label.setAlignment(Qt.AlignmentFlag.AlignTop | Qt.AlignmentFlag.AlignLeft)
        self.message = make_text()
        self.message.setParent(self.canvas)
        self.message.setAlignment(Qt.AlignmentFlag.AlignCenter)
        self.message.setAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)
        self.message.setAutoFillBackground(True)
        self.message.hide()
        self.text_area = QWidget()  # all text about the image
        self.remark.hide()
        self.text_layout = QBoxLayout(QBoxLayout.Direction.TopToBottom, self.text_area)
        words = make_column(0, self.caption, self.remark, 1)
        fill(set_spacing(self.text_layout, 4), self.colour_bar, (words, 1))
        self._both = set_spacing(QBoxLayout(QBoxLayout.Direction.TopToBottom, self), 2)
        fill(self._both, (self.canvas, 1), self.text_area)
        self.caption.set_lines(2)
        self.canvas.mouse_moved.connect(self._report_hover)
        self.canvas.mouse_left.connect(lambda: self.pixel_hovered.emit(-1, -1))
        self.canvas.clicked.connect(self._report_click)
        self.canvas.view_changed.connect(self.view_changed)
        EventListener(self, self._place_message, QEvent.Type.Resize)

    def place_text(self, *, at_side: bool) -> None:
        """Place the text to the right of the image, or under it."""
        way = QBoxLayout.Direction.LeftToRight if at_side else QBoxLayout.Direction.TopToBottom
        if way != self._both.direction():
            self._both.setDirection(way)
            self.text_area.setMinimumWidth(SIDE_TEXT_PX if at_side else 0)
            self.text_area.setMaximumWidth(SIDE_TEXT_PX if at_side else _NO_LIMIT)

    def show_preview(self, picture: Preview | None) -> None:
        """Show a preview, None for none; the view changes only with the number of pixels."""
        if picture is self.preview:
            return
        had_scale = None if self.preview is None else self.has_colour_scale
        self.preview = picture
        self.canvas.show_preview(picture)
        if picture is None:
            self.overlay.clear()
            self.colour_bar.show_scale(None)
            self.caption.setText("")
            return
        self.colour_bar.show_scale(picture.scale, picture.values)
        self.caption.setText(picture.caption)
        self.caption.setToolTip(picture.caption)
        tall = picture.pixels.shape[0] / picture.pixels.shape[1]
        if tall != self.height_over_width or had_scale != self.has_colour_scale:
            self.height_over_width = tall
            self.shape_changed.emit()

    def show_compared(
        self, preview: Preview, truth: Preview | None, difference: Preview | None, mode: str
    ) -> None:
        """Show a preview, or where known its truth, their difference, or both by wipe or blink.

        "" = itself.
        """
        self.show_preview({"truth": truth, "difference": difference}.get(mode) or preview)
        if truth is not None and mode == "wipe":
            self.overlay.show_wipe(truth)
        elif truth is not None and mode == "blink":
            self.overlay.show_blink(truth)
        else:
            self.overlay.clear()

    @property
    def has_colour_scale(self) -> bool:
        """Whether the preview has a colour scale."""
        return self.preview is not None and self.preview.scale is not None

    def show_message(self, text: str) -> None:
        """Show a message over the image (why it was skipped, or that it is out of date).

        "" removes it.
        """
        if text == self.message.text():
            return
        self.message.setText(text)
        self.message.setVisible(bool(text))
        self._place_message()

    def fit_to_box(self, box_px: tuple[float, float, float, float]) -> None:
        """Fit a part of the image, given by left, top, right and bottom in pixels, with a
        margin.
        """
        left, top, right, below = box_px
        room = self.canvas.size()
        wide = max(right - left, 4.0) * _AROUND
        high = max(below - top, 4.0) * _AROUND
        scale = min(room.width() / wide, room.height() / high)
        self.canvas.set_view(QPointF(0.5 * (left + right), 0.5 * (top + below)), scale)

    def find_contact_box_px(self) -> tuple[float, float, float, float] | None:
        """Return left, top, right and bottom of the contact outline; None without one."""
        border = None if self.preview is None else self.preview.outline_px
        if border is None or not np.isfinite(border).any():
            return None
        left, top = np.nanmin(border, axis=0).tolist()
        right, below = np.nanmax(border, axis=0).tolist()
        return left, top, right, below

    def sizeHint(self) -> QSize:  # noqa: N802
        """Return a column's share of a laptop screen."""
        return QSize(200, 220)

    def _place_message(self) -> None:
        if self.message.isHidden():
            return
        room = self.canvas.size()
        width = max(60, room.width() - 12)
        height = min(room.height() - 8, max(20, self.message.heightForWidth(width) + 4))
        self.message.resize(width, height)
        self.message.move((room.width() - width) // 2, (room.height() - height) // 2)

    def _pixel_at(self, place: QPointF) -> tuple[int, int] | None:
        point = self.canvas.to_image(place)
        row = math.floor(point.y())
        col = math.floor(point.x())
        rows, cols = (0, 0) if self.preview is None else self.preview.pixels.shape[:2]
        return (row, col) if 0 <= row < rows and 0 <= col < cols else None

    def _report_hover(self, place: QPointF) -> None:
        row, col = self._pixel_at(place) or (-1, -1)
        self.pixel_hovered.emit(row, col)

    def _report_click(self, place: QPointF) -> None:
        pixel = self._pixel_at(place)
        if pixel is not None:
            self.pixel_clicked.emit(*pixel)
