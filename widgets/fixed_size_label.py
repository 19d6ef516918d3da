"""Words that change often and lay nothing out anew: `QLabel` has the whole window arranged again for each of them."""

from __future__ import annotations

from typing import Any

from PyQt6.QtCore import QSize, Qt
from PyQt6.QtGui import QPainter
from PyQt6.QtWidgets import QLabel, QSizePolicy, QWidget

_UNDER_PX = 2


class FixedSizeLabel(QLabel):
    """Plain words in the room that there is: one line ends in dots where it is too long, several break at words."""

    def __init__(self, text: str = "", parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._said, self._lines = text, 1
        self.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)
        self.setTextFormat(Qt.TextFormat.PlainText)

    def text(self) -> str:
        """What it says, all of it."""
        return self._said

    def setText(self, a0: str | None) -> None:  # noqa: N802
        """Say something else."""
        if (a0 or "") != self._said:
            self._said = a0 or ""
            self.update()

    def set_lines(self, lines: int) -> None:
        """Have room for so many lines, whether they are needed or not; one has to do where there is no more."""
        if lines != self._lines:
            self._lines = lines
            self.setWordWrap(lines > 1)
            policy = QSizePolicy.Policy.Maximum if lines > 1 else QSizePolicy.Policy.Fixed
            self.setSizePolicy(QSizePolicy.Policy.Ignored, policy)
            self.updateGeometry()

    def sizeHint(self) -> QSize:  # noqa: N802
        """The lines of letters, however wide."""
        return QSize(0, self._lines * self.fontMetrics().lineSpacing() + _UNDER_PX)

    def minimumSizeHint(self) -> QSize:  # noqa: N802
        """One line of them."""
        return QSize(0, self.fontMetrics().lineSpacing() + _UNDER_PX)

    def paintEvent(self, a0: Any) -> None:  # noqa: N802
        """The words."""
        del a0
        painter, room, how = QPainter(self), self.contentsRect(), self.alignment()
        painter.setPen(self.palette().color(self.foregroundRole()))
        if self.wordWrap():
            painter.drawText(room, int(how) | int(Qt.TextFlag.TextWordWrap), self._said)
        else:
            end = Qt.TextElideMode.ElideRight
            painter.drawText(room, int(how), self.fontMetrics().elidedText(self._said, end, room.width()))
