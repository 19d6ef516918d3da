"""Notifications, never modal: a sentence with buttons of one action or menu each."""

from collections.abc import Callable, Sequence

from PyQt6.QtCore import Qt, pyqtSignal
from PyQt6.QtWidgets import (
    QFrame,
    QHBoxLayout,
    QMenu,
    QPushButton,
    QToolButton,
    QVBoxLayout,
)

from pipeline.core.errors import escape_text
from widgets.style.base import PREFERS, YIELDS
from widgets.style.run_bar import RunBar
from widgets.style.styling import (
    fill,
    make_button,
    make_row,
    make_single_shot_timer,
    make_text,
    name_widget,
)

Act = Callable[[], object]
# label, and what it does or the entries of its menu
Choice = tuple[str, Act | Sequence[tuple[str, Act]]]


def make_choice_button(choice: Choice, then: Act) -> QPushButton:
    """Return a button that calls `then`, then acts.

    One with a menu does so with the chosen entry.
    """
    words, act = choice
    button = make_button(escape_text(words), f"offer_{words.split(maxsplit=1)[0].lower()}")

    def follow(chosen: Act) -> Callable[[], None]:
        def run() -> None:
            then()
            chosen()

        return run

    if callable(act):
        button.clicked.connect(follow(act))
        return button
    menu = QMenu(button)
    for text, chosen in act:
        action = menu.addAction(escape_text(text).replace("&", "&&"))
        assert action is not None
        action.triggered.connect(follow(chosen))
    button.setMenu(menu)
    return button


def replace_buttons(
    row: QHBoxLayout, at: int, old: Sequence[QPushButton], choices: Sequence[Choice], then: Act
) -> list[QPushButton]:
    """Put a button for each of the choices into a row in place of the `old` ones; returns them."""
    for button in old:
        row.removeWidget(button)
        button.hide()  # it lies over what takes its place until it is deleted
        button.deleteLater()
    buttons = [make_choice_button(choice, then) for choice in choices]
    for place, button in enumerate(buttons, start=at):
        row.insertWidget(place, button)
    return buttons


_READ_MS = 5000  # until a sentence without buttons leaves


class NotificationBar(QFrame):
    """Hidden until `show_notification`.

    Each button acts once and hides it. `run_bar` shows what the sentence is about.

    A sentence without buttons leaves by itself after a time to read it, unless it is being read.
    """

    message_shown = pyqtSignal(str)

    def __init__(self, name: str, *, read_ms: int = _READ_MS, choices_below: bool = False) -> None:
        super().__init__()
        name_widget(self, name)
        self.setFrameShape(QFrame.Shape.StyledPanel)
        self.setAutoFillBackground(True)
        self._text = make_text()
        self.run_bar = RunBar(name)
        self._away = name_widget(QToolButton(), "", "Dismiss", "Dismiss")
        self._text.setTextFormat(Qt.TextFormat.PlainText)  # file names are no markup
        self._text.setSizePolicy(YIELDS, PREFERS)
        self._away.setText("\N{MULTIPLICATION SIGN}")
        self._away.setAutoRaise(True)
        self._away.clicked.connect(self.hide)
        self._choices = QHBoxLayout()
        self._row = make_row(6, (self._text, 1), self.run_bar)
        self._column = fill(QVBoxLayout(self), self._row)
        self._column.setContentsMargins(8, 3, 8, 3)
        fill(self._column if choices_below else self._row, fill(self._choices, int(choices_below)))
        fill(self._row, self._away)
        self.buttons: list[QPushButton] = []
        self._read = make_single_shot_timer(self, read_ms, self._leave)
        self.hide()

    @property
    def text(self) -> str:
        """The sentence on display."""
        return self._text.text()

    @property
    def is_being_read(self) -> bool:
        """Whether it does not leave now: the pointer is over it."""
        return self.underMouse()

    def show_notification(
        self, sentence: str, choices: Sequence[Choice] = (), *, stays: bool = False
    ) -> None:
        """Show one sentence and a button for each of `choices`.

        With one, or if it `stays`, it does not leave by itself.
        """
        self.buttons = replace_buttons(self._choices, 1, self.buttons, choices, self.hide)
        self._text.setText(sentence[:1].upper() + sentence[1:])
        self.message_shown.emit(self.text)
        self.show()
        self.updateGeometry()
        self._read.stop() if stays or choices else self._read.start()

    def _leave(self) -> None:
        self._read.start() if self.is_being_read else self.hide()
