"""The bell: the last messages, for one that left before it was read."""

import time
from collections import deque

from PyQt6.QtWidgets import QMenu, QToolButton

from pipeline.core.errors import escape_text
from widgets.style.icons import make_command_icon
from widgets.style.styling import copy_text, name_widget

MOST_MESSAGES = 10


class MessageBell(QToolButton):
    """A menu of the newest messages, the last one first; an entry copies its message."""

    def __init__(self) -> None:
        super().__init__()
        tip = "The last ten messages; a click on one copies it"
        name_widget(self, "bell", "last messages", tip)
        self.setIcon(make_command_icon("bell"))
        self.setAutoRaise(True)
        self.setPopupMode(QToolButton.ToolButtonPopupMode.InstantPopup)
        self.messages = deque[tuple[str, str]](maxlen=MOST_MESSAGES)  # time and sentence
        self._menu = QMenu(self)
        self._menu.aboutToShow.connect(self._list_messages)
        self.setMenu(self._menu)
        self.setEnabled(False)

    def add_message(self, sentence: str) -> None:
        """Keep a message; one that says the same as the last replaces it."""
        if self.messages and self.messages[-1][1] == sentence:
            self.messages.pop()
        self.messages.append((time.strftime("%H:%M:%S"), sentence))
        self.setEnabled(True)

    def _list_messages(self) -> None:
        self._menu.clear()
        for said_at, sentence in reversed(self.messages):
            text = escape_text(sentence).replace("&", "&&")
            action = self._menu.addAction(f"{said_at}  {text}")
            if action is not None:
                action.triggered.connect(lambda _=False, sentence=sentence: copy_text(sentence))
