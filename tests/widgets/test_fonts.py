"""Text has one size, and figures are larger."""

from __future__ import annotations

from PyQt6.QtWidgets import QApplication, QLabel

from widgets.style.base import TEXT_PT, enlarge_font, set_text_size


def test_text_has_its_size_whatever_the_desktops_letters_are(qapp, qtbot):
    before = QApplication.font()
    larger = QApplication.font()
    larger.setPointSizeF(13.5)
    try:
        QApplication.setFont(larger)
        set_text_size()
        label = QLabel("title")
        qtbot.addWidget(label)
        assert label.font().pointSizeF() == TEXT_PT
        enlarge_font(label, 2.0)
        assert label.font().pointSizeF() == TEXT_PT + 2.0
    finally:
        QApplication.setFont(before)
