"""What a stranger wrote into a file is shown letter by letter."""

from __future__ import annotations

import string
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PyQt6.QtCore import QPoint, Qt
from PyQt6.QtGui import QTextDocument
from PyQt6.QtWidgets import QApplication, QLabel, QMessageBox, QToolTip, QWidget

from app.views.scene_geometry import _format_captions
from pipeline.sensors.alignment import Alignment
from pipeline.translation.alignment.refine import AlignmentFit, Refinement
from widgets.align.refine_box import RefineBox
from widgets.stages.probes_panel import TracePanel
from widgets.style.plain_text_style import PlainTextStyle

HOSTILE = "<img src='/dev/zero'><b>mine</b>"
FIT = AlignmentFit(surface_mm=0.1, outline_mm=0.2, share_compared=1.0, n_touches=3)
REFINED = Refinement(
    alignment=Alignment(alignment_from_source=np.eye(4), target_from_alignment=np.eye(4)),
    motion=np.eye(4),
    pivot_mm=np.zeros(3),
    std=np.zeros(6),
    weak_directions=(),
    used_fit=(FIT, FIT),
    held_out_fit=None,
    n_iterations=1,
    converged=True,
)
_PIECES = st.sampled_from(
    [HOSTILE, "</span>", "&amp;", "<!--", "<style>", "&#0;", "<table><tr><td>", "]]>", "'", '"']
)
WORDS = st.lists(
    _PIECES | st.text(string.printable, min_size=1, max_size=9), min_size=1, max_size=5
).map("x".join)


@pytest.fixture
def styled(qapp):
    before = QApplication.style().name()
    QApplication.setStyle(PlainTextStyle())
    yield
    QToolTip.hideText()
    QApplication.setStyle(before)


def test_labels_and_tooltips_are_plain_text(qtbot, styled):
    window = QWidget()
    plain = QLabel(HOSTILE, window)
    rich = QLabel("<b>ours</b>", window)
    rich.setTextFormat(Qt.TextFormat.RichText)
    qtbot.addWidget(window)
    window.show()
    assert plain.textFormat() == Qt.TextFormat.PlainText
    assert rich.textFormat() == Qt.TextFormat.RichText
    QToolTip.showText(QPoint(10, 10), HOSTILE, window)
    [tip] = [
        w for w in QApplication.topLevelWidgets() if isinstance(w, QLabel) and w.text() == HOSTILE
    ]
    assert tip.textFormat() == Qt.TextFormat.PlainText


def test_the_programs_own_message_boxes_may_be_rich(qtbot, styled):
    box = QMessageBox()
    qtbot.addWidget(box)
    box.setText("<b>Keys</b>")
    box.show()
    assert box.findChild(QLabel, "qt_msgbox_label").textFormat() == Qt.TextFormat.AutoText


def read_letters(rich: str) -> str:
    document = QTextDocument()
    document.setHtml(rich)
    return "".join(document.toPlainText().split())


@settings(max_examples=100, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(WORDS, WORDS, WORDS)
def test_words_of_a_file_stay_letters_in_rich_text(qapp, title, text, ending):
    panel = TracePanel()
    box = RefineBox()
    panel.show_steps([(title, text)], ending=ending)
    shown = read_letters(panel.findChild(QLabel).text())
    for words in (title, text, ending):
        assert "".join(words.split()) in shown
    box.show_message(title)  # an error may name a file
    assert read_letters(box.text.text()) == "".join(title.split())
    box.show_result(replace(REFINED, notes=(text,)), title)
    shown = read_letters(box.text.text())
    for words in (title, text):
        assert "".join(words.split()) in shown
    for caption in _format_captions(title, 2.0)[:2]:
        assert "".join(title.split()) in read_letters(caption)
