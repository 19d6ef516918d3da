"""Scroll area for a dock: it scrolls up and down only, and is at least as wide as its content."""

from PyQt6.QtCore import QSize, Qt
from PyQt6.QtWidgets import QFrame, QScrollArea


class VerticalScrollArea(QScrollArea):
    """Cuts nothing off at its sides; call `updateGeometry` when the content becomes wider."""

    def __init__(self) -> None:
        super().__init__()
        self.setWidgetResizable(True)
        self.setFrameShape(QFrame.Shape.NoFrame)
        self.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)

    def minimumSizeHint(self) -> QSize:  # noqa: N802
        """Return the width of the content next to a scroll bar."""
        hint, body, bar = super().minimumSizeHint(), self.widget(), self.verticalScrollBar()
        if body is None or bar is None:
            return hint
        return QSize(body.minimumSizeHint().width() + bar.sizeHint().width(), hint.height())
