"""Notification of an error: one sentence, buttons that mend it, and details on demand; never modal."""

from __future__ import annotations

from collections.abc import Sequence

from PyQt6.QtCore import QEvent, Qt
from PyQt6.QtWidgets import (
    QFrame,
    QHBoxLayout,
    QLabel,
    QPlainTextEdit,
    QPushButton,
    QToolButton,
    QVBoxLayout,
    QWidget,
)

from widgets.choice_buttons import Choice, make_choice_button
from widgets.event_listener import EventListener
from widgets.icons import StateIcon
from widgets.styling import copy_text, make_single_shot_timer
from widgets.theme import is_dark

_READ_MS = 30_000  # until an error leaves; the log keeps it
_ON_LIGHT, _ON_DARK = ("#fdecea", "#d9a09a", "#5c1a14"), ("#4a2522", "#8c4a44", "#ffd9d4")


class Banner(QFrame):
    """Hidden until `show_problem`; leaves by itself unless something mends it or it is being read.

    It is being read with the pointer over it or the details open.
    """

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setObjectName("banner")
        self._take_colours()
        self._sign, self._text = StateIcon(20), QLabel()
        self._sign.show_state("failed")
        self._text.setWordWrap(True)
        self._text.setTextFormat(Qt.TextFormat.PlainText)  # file names are no markup
        self._text.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self._more, self._copy, self._away = QPushButton("Details"), QPushButton("Copy report"), QToolButton()
        self._more.setCheckable(True)
        self._away.setText("\N{MULTIPLICATION SIGN}")
        self._away.setAutoRaise(True)
        self._away.setToolTip("Dismiss")
        self._away.setAccessibleName("Dismiss")
        self._details = QPlainTextEdit()
        self._details.setAccessibleName("details")
        self._details.setReadOnly(True)
        self._details.setMaximumHeight(160)
        row = QHBoxLayout()
        row.addWidget(self._sign)
        row.addWidget(self._text, 1)
        for button in (self._more, self._copy, self._away):
            row.addWidget(button)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(8, 4, 8, 4)
        layout.addLayout(row)
        self._remedies = QHBoxLayout()
        self._remedies.addStretch(1)
        layout.addLayout(self._remedies)
        layout.addWidget(self._details)
        self.buttons: list[QPushButton] = []  # that mend the problem
        self._leave_later = make_single_shot_timer(self, _READ_MS, self._leave)
        self._more.toggled.connect(self._details.setVisible)
        self._copy.clicked.connect(self.copy_report)
        self._away.clicked.connect(self.hide)
        EventListener(self, self._take_colours, QEvent.Type.PaletteChange)
        self._details.hide()
        self.hide()

    def _take_colours(self) -> None:
        ground, rim, letters = _ON_DARK if is_dark(self.palette()) else _ON_LIGHT
        sheet = f"#banner {{ background: {ground}; border: 1px solid {rim}; }} #banner QLabel {{ color: {letters}; }}"
        if sheet != self.styleSheet():
            self.setStyleSheet(sheet)

    @property
    def text(self) -> str:
        """The sentence on display."""
        return self._text.text()

    @property
    def details(self) -> str:
        """The text behind `Details`."""
        return self._details.toPlainText()

    def show_problem(self, sentence: str, details: str = "", choices: Sequence[Choice] = ()) -> None:
        """Show one sentence, a button for each of `choices`, and details on demand."""
        for button in self.buttons:
            self._remedies.removeWidget(button)
            button.deleteLater()
        self.buttons = [make_choice_button(choice, self.hide) for choice in choices]
        for button in self.buttons:
            self._remedies.addWidget(button)
        self._text.setText(sentence[:1].upper() + sentence[1:])
        self._details.setPlainText(details)
        self._more.setVisible(bool(details))
        self._more.setChecked(False)
        self.show()
        self.updateGeometry()
        self._leave_later.stop() if choices else self._leave_later.start()

    def _leave(self) -> None:
        self._leave_later.start() if self.underMouse() or self._more.isChecked() else self.hide()

    def copy_report(self) -> None:
        """Copy sentence and details to the clipboard."""
        copy_text(f"{self.text}\n\n{self.details}".strip() + "\n")
