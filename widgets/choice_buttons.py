"""Buttons of a notification: one action each, or a menu of several."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from PyQt6.QtWidgets import QMenu, QPushButton

from pipeline.base.text import escape_text

Act = Callable[[], object]
Choice = tuple[str, Act | Sequence[tuple[str, Act]]]  # label, and what it does or the entries of its menu


def make_choice_button(choice: Choice, then: Act) -> QPushButton:
    """Return a button that calls `then`, then acts; one with a menu does so with the chosen entry."""
    words, act = choice
    button = QPushButton(escape_text(words))
    button.setObjectName(f"offer_{words.split(maxsplit=1)[0].lower()}")

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
