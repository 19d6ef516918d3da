"""Sizes of letters: nothing in the window is smaller than a caption."""

from PyQt6.QtGui import QFont
from PyQt6.QtWidgets import QWidget

MIN_FONT_PT = 8.5  # smallest letters of the window


def make_caption_font(font: QFont) -> QFont:
    """Return a font a point smaller than `font`, but at least `MIN_FONT_PT`."""
    return _resize(font, -1.0)


def resize_font(widget: QWidget, by_pt: float = -1.0) -> None:
    """Make a widget's font larger or smaller than the window's, by default that of captions."""
    widget.setFont(_resize(widget.font(), by_pt))


def _resize(font: QFont, by_pt: float) -> QFont:
    resized = QFont(font)
    resized.setPointSizeF(max(MIN_FONT_PT, font.pointSizeF() + by_pt))
    return resized
