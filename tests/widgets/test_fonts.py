"""No letters are smaller than a caption, whatever the size of the desktop's letters."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st
from PyQt6.QtGui import QFont
from PyQt6.QtWidgets import QLabel

from widgets.style.base import MIN_FONT_PT, make_caption_font, resize_font


@given(base_pt=st.floats(5.0, 30.0))
def test_a_caption_is_a_point_smaller_but_never_too_small(qapp, base_pt):
    font = QFont()
    font.setPointSizeF(base_pt)
    caption = make_caption_font(font).pointSizeF()
    assert caption == max(MIN_FONT_PT, font.pointSizeF() - 1.0)
    assert make_caption_font(make_caption_font(font)).pointSizeF() >= MIN_FONT_PT


def test_a_title_is_larger(qtbot):
    label = QLabel("title")
    qtbot.addWidget(label)
    before_pt = label.font().pointSizeF()
    resize_font(label, 9.0)
    assert label.font().pointSizeF() == before_pt + 9.0
