"""Log panel with a filter by level."""

import logging
from collections import deque

from PyQt6.QtWidgets import (
    QComboBox,
    QLabel,
    QPlainTextEdit,
    QPushButton,
    QWidget,
)

from widgets.style.styling import make_column, make_row, name_widget

_KEPT = 5000
_LEVELS = {
    "everything": logging.DEBUG,
    "info": logging.INFO,
    "warnings": logging.WARNING,
    "errors": logging.ERROR,
}


class LogPanel(QWidget):
    """Keeps the newest lines and shows those at or above the selected level."""

    def __init__(self) -> None:
        super().__init__()
        self._lines: deque[tuple[int, str]] = deque(maxlen=_KEPT)
        self._level = name_widget(QComboBox(), "log_level", "lowest level")
        self._level.addItems(list(_LEVELS))
        self._level.setCurrentText("info")
        self._level.currentTextChanged.connect(self._fill)
        clear = QPushButton("Clear")
        clear.clicked.connect(self.clear)
        self._text = name_widget(QPlainTextEdit(), "", "log")
        self._text.setReadOnly(True)
        self._text.setMaximumBlockCount(_KEPT)
        self._text.setLineWrapMode(QPlainTextEdit.LineWrapMode.NoWrap)
        row = make_row(6, QLabel("show"), self._level, 1, clear)
        make_column(2, row, self._text, around_px=(4, 2, 4, 2), on=self)

    @property
    def text(self) -> str:
        """The visible lines."""
        return self._text.toPlainText()

    def show_line(self, level: int, text: str) -> None:
        """Add one line of the log."""
        self._lines.append((level, text))
        if level >= _LEVELS[self._level.currentText()]:
            self._text.appendPlainText(text)

    def clear(self) -> None:
        """Remove all lines."""
        self._lines.clear()
        self._text.clear()

    def _fill(self, name: str) -> None:
        self._text.setPlainText(
            "\n".join(text for level, text in self._lines if level >= _LEVELS[name])
        )
