"""What a stranger wrote into a file is shown letter by letter."""

from __future__ import annotations

import pytest
from PyQt6.QtCore import QPoint, Qt
from PyQt6.QtWidgets import QApplication, QLabel, QMessageBox, QToolTip, QWidget

from widgets.plain_text_style import PlainTextStyle

HOSTILE = "<img src='/dev/zero'><b>mine</b>"


@pytest.fixture
def styled(qapp):
    before = QApplication.style().name()
    QApplication.setStyle(PlainTextStyle())
    yield
    QToolTip.hideText()
    QApplication.setStyle(before)


def test_labels_and_tooltips_are_plain_text(qtbot, styled):
    window = QWidget()
    plain, rich = QLabel(HOSTILE, window), QLabel("<b>ours</b>", window)
    rich.setTextFormat(Qt.TextFormat.RichText)
    qtbot.addWidget(window)
    window.show()
    assert plain.textFormat() == Qt.TextFormat.PlainText
    assert rich.textFormat() == Qt.TextFormat.RichText
    QToolTip.showText(QPoint(10, 10), HOSTILE, window)
    [tip] = [w for w in QApplication.topLevelWidgets() if isinstance(w, QLabel) and w.text() == HOSTILE]
    assert tip.textFormat() == Qt.TextFormat.PlainText


def test_the_programs_own_message_boxes_may_be_rich(qtbot, styled):
    box = QMessageBox()
    qtbot.addWidget(box)
    box.setText("<b>Keys</b>")
    box.show()
    assert box.findChild(QLabel, "qt_msgbox_label").textFormat() == Qt.TextFormat.AutoText
