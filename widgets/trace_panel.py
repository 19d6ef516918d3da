"""Trace of one pixel through all stages, as a sentence."""

from collections.abc import Sequence
from html import escape

from PyQt6.QtCore import QEvent, Qt
from PyQt6.QtWidgets import QFrame, QLabel, QScrollArea, QVBoxLayout, QWidget

from widgets.base import EventListener
from widgets.theme import get_theme_colours, to_hex

_INVITATION = (
    "Move the mouse over an image to follow that pixel through every stage. "
    "A click pins it, up to five (again, or <b>F</b>, to release); <b>Esc</b> clears all."
)

_LINES = 2  # more lines scroll


class TracePanel(QScrollArea):
    """Shows a pixel trace, one titled step after the other."""

    def __init__(self) -> None:
        super().__init__()
        self.setObjectName("trace")
        self.setAccessibleName("trace of the pixel")
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
        self.setFixedHeight(_LINES * self.fontMetrics().lineSpacing() + 3)
        self.text = ""
        self._shown: tuple[Sequence[tuple[str, str]], bool, str, bool] = ((), False, "", False)
        EventListener(self, self._show_again, QEvent.Type.PaletteChange)

    def _show_again(self) -> None:
        steps, pinned, ending, waits = self._shown
        self.show_steps(steps, pinned=pinned, ending=ending, is_waiting=waits)

    def show_steps(
        self, steps: Sequence[tuple[str, str]], *, pinned: bool = False, ending: str = "", is_waiting: bool = False
    ) -> None:
        """Show (stage title, text) pairs in order, and why the trace ends; in plain colour while `is_waiting`."""
        self._shown = steps, pinned, ending, is_waiting
        self.text = " → ".join(text for _, text in steps)
        if not steps:
            self._label.setText(_INVITATION)
            return
        soft, alarm = (
            to_hex(get_theme_colours(self.palette()).secondary_text),
            to_hex(get_theme_colours(self.palette()).warning_text),
        )
        parts = [f"<span style='color:{soft}'>{escape(title)}</span> <b>{escape(text)}</b>" for title, text in steps]
        sentence = " &nbsp;→&nbsp; ".join(parts)
        if ending:
            sentence += f" &nbsp; <span style='color:{soft if is_waiting else alarm}'>{escape(ending)}</span>"
        self._label.setText(sentence + (" &nbsp; <i>pinned</i>" if pinned else ""))
