"""Notification of an error: one sentence, buttons that mend it, and details on demand.

Never modal.
"""

from collections.abc import Sequence

from PyQt6.QtCore import QEvent, Qt
from PyQt6.QtWidgets import QPlainTextEdit, QPushButton

from widgets.style.base import EventListener
from widgets.style.icons import StateIcon
from widgets.style.notification_bar import Choice, NotificationBar
from widgets.style.styling import copy_text, name_widget
from widgets.style.theme import is_dark

_READ_MS = 30_000  # until an error leaves; the log keeps it
_ON_LIGHT = ("#fdecea", "#d9a09a", "#5c1a14")
_ON_DARK = ("#4a2522", "#8c4a44", "#ffd9d4")


class Banner(NotificationBar):
    """Hidden until `show_problem`.

    Leaves by itself unless something mends it or its details are open.
    """

    def __init__(self) -> None:
        super().__init__("banner", read_ms=_READ_MS, choices_below=True)
        self._take_colours()
        EventListener(self, self._take_colours, QEvent.Type.PaletteChange)
        sign = StateIcon(20)
        sign.show_state("failed")
        self._text.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self._more = QPushButton("Details")
        self._more.setCheckable(True)
        self._details = name_widget(QPlainTextEdit(), "", "details")
        self._details.setReadOnly(True)
        self._details.setMaximumHeight(160)
        self._row.insertWidget(0, sign)
        copy = QPushButton("Copy report")
        copy.clicked.connect(self.copy_report)
        for button in (self._more, copy):
            self._row.insertWidget(self._row.count() - 1, button)
        self._column.addWidget(self._details)
        self._more.toggled.connect(self._details.setVisible)
        self._details.hide()

    def _take_colours(self) -> None:
        ground, rim, letters = _ON_DARK if is_dark(self.palette()) else _ON_LIGHT
        sheet = (
            f"#banner {{ background: {ground}; border: 1px solid {rim}; }} #banner QLabel "
            f"{{ color: {letters}; }}"
        )
        if sheet != self.styleSheet():
            self.setStyleSheet(sheet)

    @property
    def details(self) -> str:
        """The text behind `Details`."""
        return self._details.toPlainText()

    @property
    def is_being_read(self) -> bool:
        """Whether it does not leave now: the details are open, or the pointer is over it."""
        return self._more.isChecked() or super().is_being_read

    def show_problem(
        self, sentence: str, details: str = "", choices: Sequence[Choice] = ()
    ) -> None:
        """Show one sentence, a button for each of `choices`, and details on demand."""
        self._details.setPlainText(details)
        self._more.setVisible(bool(details))
        self._more.setChecked(False)
        self.show_notification(sentence, choices)

    def copy_report(self) -> None:
        """Copy sentence and details to the clipboard."""
        copy_text(f"{self.text}\n\n{self.details}".strip() + "\n")
