"""One line for the warnings of the frame on screen; empty without any."""

import re
from collections.abc import Callable, Sequence
from typing import Any

from PyQt6.QtCore import QEvent, Qt
from PyQt6.QtWidgets import QHBoxLayout, QPushButton, QToolTip, QWidget

from widgets.style.base import EventListener, FixedSizeLabel, resize_font
from widgets.style.icons import StateIcon
from widgets.style.notification_bar import Choice, make_choice_button
from widgets.style.styling import set_spacing

_BETWEEN = "   ·   "
_SPARE_PX = 4  # what the last letter of a text may need beyond its measured width
_A_REASON = re.compile("[:;]")  # what follows is the reason or the remedy


class WarningLine(QWidget):
    """The warnings of all stages in one line, with their remedies.

    The tooltip, also shown by a click, has all text.
    """

    def __init__(self) -> None:
        super().__init__()
        self.setObjectName("warning_line")
        self.text = ""  # all of it, whatever fits
        self._sentences: tuple[str, ...] = ()
        self._sign = StateIcon()
        self.label = FixedSizeLabel()
        layout = set_spacing(QHBoxLayout(self), 5, (6, 0, 6, 0))
        layout.addWidget(self._sign)
        layout.addWidget(self.label, 1)
        self.buttons: list[QPushButton] = []  # that mend what is warned of
        EventListener(self, self._fit, QEvent.Type.Resize)

    def show_warnings(self, warnings: Sequence[tuple[str, str]]) -> None:
        """Show (stage title, warning) pairs, the most important first."""
        sentences = tuple(f"{title}: {warning}" for title, warning in warnings)
        if sentences != self._sentences:
            self._sentences = sentences
            self.text = _BETWEEN.join(sentences)
            self.setToolTip("\n".join(sentences))
            self._sign.show_state("warning" if sentences else "")
            self._fit()

    def show_remedies(self, choices: Sequence[Choice]) -> None:
        """Show a button for each of `choices`; the line stays as high as it is."""
        if [text for text, _ in choices] == [button.text() for button in self.buttons]:
            return
        layout = self.layout()
        assert layout is not None
        for button in self.buttons:
            layout.removeWidget(button)
            button.deleteLater()
        self.buttons = [make_choice_button(choice, lambda: None) for choice in choices]
        for button in self.buttons:
            resize_font(button)
            button.setFixedHeight(self.label.sizeHint().height())
            layout.addWidget(button)
        self._fit()

    def mousePressEvent(self, a0: Any) -> None:  # noqa: N802
        """Show the full text as a tooltip."""
        QToolTip.showText(a0.globalPosition().toPoint(), self.toolTip(), self)

    def _fit(self) -> None:
        metrics = self.label.fontMetrics()
        layout = self.layout()
        assert layout is not None
        around = layout.contentsMargins()
        taken = sum(button.sizeHint().width() + layout.spacing() for button in self.buttons)
        room = max(
            60,
            self.width()
            - self._sign.width()
            - layout.spacing()
            - around.left()
            - around.right()
            - taken,
        )
        text = fit_sentences(
            self._sentences, lambda words: metrics.horizontalAdvance(words) <= room - _SPARE_PX
        )
        self.label.setText(metrics.elidedText(text, Qt.TextElideMode.ElideRight, room))


def fit_sentences(sentences: Sequence[str], fits: Callable[[str], bool]) -> str:
    """Return as many sentences as fit, none cut: first what is wrong, then the reasons as far as
    there is room.
    """
    brief = [_without_reason(sentence) for sentence in sentences]
    count = next(
        (n for n in range(len(sentences), 1, -1) if fits(_join(brief[:n], len(sentences)))),
        min(1, len(sentences)),
    )
    shown = brief[:count]
    for i in range(count):
        whole = [*shown[:i], sentences[i], *shown[i + 1 :]]
        if fits(_join(whole, len(sentences))):
            shown = whole
    return _join(shown, len(sentences))


def _without_reason(sentence: str) -> str:
    title, _, warning = sentence.partition(": ")
    return f"{title}: {_A_REASON.split(warning, maxsplit=1)[0]}"


def _join(shown: Sequence[str], n_all: int) -> str:
    more = [f"and {n_all - len(shown)} more"] if n_all > len(shown) else []
    return _BETWEEN.join([*shown, *more])
