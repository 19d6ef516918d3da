"""The caption under a 3D view."""

from __future__ import annotations

from PyQt6.QtCore import Qt

from widgets.style.plain_text_style import PlainTextStyle
from widgets.views.view_3d_panel import FittingLabel


def test_a_caption_stays_rich_text_under_the_plain_style(qtbot):
    label = FittingLabel()
    qtbot.addWidget(label)
    label.set_texts("gelslim frame <b style='color:#f00'>x</b>", "<b>x</b>")
    label.setStyle(PlainTextStyle())
    label.show()
    assert label.textFormat() == Qt.TextFormat.RichText
    assert label.toolTip() == "gelslim frame x"
