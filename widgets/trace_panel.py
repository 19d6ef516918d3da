"""One pixel through every stage, read like a sentence."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from PyQt6.QtCore import Qt
from PyQt6.QtWidgets import QFrame, QLabel, QScrollArea, QVBoxLayout, QWidget

_INVITATION = (
    "Move the mouse over a picture to follow that pixel through every stage. "
    "A click pins it (again, or <b>F</b>, to let go); <b>Esc</b> takes the crosshairs away."
)

_LINES = 2  # more of them scroll


class TracePanel(QScrollArea):
    """Shows what `pipeline.trace` says, one titled step after the other."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setObjectName("trace")
        self.setWidgetResizable(True)
        self.setFrameShape(QFrame.Shape.NoFrame)
        self._label = QLabel(_INVITATION)
        self._label.setWordWrap(True)
        self._label.setTextFormat(Qt.TextFormat.RichText)
        self._label.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self._label.setAlignment(Qt.AlignmentFlag.AlignTop)
        body = QWidget()
        layout = QVBoxLayout(body)
        layout.setContentsMargins(6, 1, 6, 1)
        layout.addWidget(self._label)
        self.setWidget(body)
        self.setFixedHeight(_LINES * self.fontMetrics().lineSpacing() + 6)
        self.text = ""

    def show_steps(self, steps: Sequence[tuple[str, str]], *, pinned: bool = False, ending: str = "") -> None:
        """Show (stage title, what is there) pairs in order, and why the trace ends."""
        self.text = " → ".join(text for _, text in steps)
        if not steps:
            self._label.setText(_INVITATION)
            return
        parts = [f"<span style='color:#6b7280'>{escape(title)}</span> <b>{escape(text)}</b>" for title, text in steps]
        sentence = " &nbsp;→&nbsp; ".join(parts)
        if ending:
            sentence += f" &nbsp; <span style='color:#96401f'>{escape(ending)}</span>"
        self._label.setText(sentence + (" &nbsp; <i>pinned</i>" if pinned else ""))
