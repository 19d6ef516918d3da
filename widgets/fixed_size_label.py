"""Label for text that changes often: unlike `QLabel`, a new text does not lay out the window again."""

from typing import Any

from PyQt6.QtCore import QSize, Qt
from PyQt6.QtGui import QPainter
from PyQt6.QtWidgets import QLabel, QSizePolicy

_UNDER_PX = 2


class FixedSizeLabel(QLabel):
    """Plain text in the available room: one line is elided, several lines wrap."""

    def __init__(self, text: str = "") -> None:
        super().__init__()
        self._said, self._lines = text, 1
        self.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)
        self.setTextFormat(Qt.TextFormat.PlainText)

    def text(self) -> str:
        """The whole text."""
        return self._said

    def setText(self, a0: str | None) -> None:  # noqa: N802
        """Show another text."""
        if (a0 or "") != self._said:
            self._said = a0 or ""
            self.update()

    def set_lines(self, lines: int) -> None:
        """Reserve room for this many lines, needed or not; shrinks to one if there is no room."""
        if lines != self._lines:
            self._lines = lines
            self.setWordWrap(lines > 1)
            policy = QSizePolicy.Policy.Maximum if lines > 1 else QSizePolicy.Policy.Fixed
            self.setSizePolicy(QSizePolicy.Policy.Ignored, policy)
            self.updateGeometry()

    def sizeHint(self) -> QSize:  # noqa: N802
        """Return the height of the lines at any width."""
        return QSize(0, self._lines * self.fontMetrics().lineSpacing() + _UNDER_PX)

    def minimumSizeHint(self) -> QSize:  # noqa: N802
        """Return the height of one line."""
        return QSize(0, self.fontMetrics().lineSpacing() + _UNDER_PX)

    def paintEvent(self, a0: Any) -> None:  # noqa: N802
        """Paint the text."""
        del a0
        painter, room, how = QPainter(self), self.contentsRect(), self.alignment()
        painter.setPen(self.palette().color(self.foregroundRole()))
        if self.wordWrap():
            painter.drawText(room, int(how) | int(Qt.TextFlag.TextWordWrap), self._said)
        else:
            end = Qt.TextElideMode.ElideRight
            painter.drawText(room, int(how), self.fontMetrics().elidedText(self._said, end, room.width()))
