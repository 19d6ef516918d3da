"""One line for what is doubted of the frame on screen; empty while nothing is."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from PyQt6.QtCore import Qt
from PyQt6.QtWidgets import QHBoxLayout, QLabel, QSizePolicy, QWidget

from widgets.icons import state_pixmap
from widgets.looks import spaced


class WarningLine(QWidget):
    """The doubts of every slot in one line, whole sentences in the tool tip."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setObjectName("warning_line")
        self.text = ""  # all of it, however much there is room for
        self._sign = QLabel()
        self._sign.setPixmap(state_pixmap("doubtful"))
        room = self._sign.sizePolicy()
        room.setRetainSizeWhenHidden(True)  # nothing moves when doubts come and go
        self._sign.setSizePolicy(room)
        self._label = QLabel()
        self._label.setTextFormat(Qt.TextFormat.PlainText)
        self._label.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)
        layout = spaced(QHBoxLayout(self), 5, (6, 0, 6, 0))
        layout.addWidget(self._sign)
        layout.addWidget(self._label, 1)
        self._sign.hide()

    def show_doubts(self, doubts: Sequence[tuple[str, str]]) -> None:
        """(title of a slot, what is doubted of it), the most telling first."""
        told = [f"{title}: {doubt}" for title, doubt in doubts]
        text = "   ·   ".join(told)
        if text != self.text:
            self.text = text
            self.setToolTip("\n".join(told))
            self._elide()
            self._sign.setVisible(bool(told))

    def resizeEvent(self, a0: Any) -> None:  # noqa: N802
        """As much as there is room for."""
        super().resizeEvent(a0)
        self._elide()

    def _elide(self) -> None:
        end = Qt.TextElideMode.ElideRight
        self._label.setText(self._label.fontMetrics().elidedText(self.text, end, max(60, self._label.width())))
