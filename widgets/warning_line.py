"""One line for what is doubted of the frame on screen; empty while nothing is."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from typing import Any

from PyQt6.QtCore import Qt
from PyQt6.QtWidgets import QHBoxLayout, QToolTip, QWidget

from widgets.fixed_size_label import FixedSizeLabel
from widgets.icons import StateIcon
from widgets.styling import set_spacing

_BETWEEN = "   ·   "
_A_REASON = re.compile("[:;]")  # what follows one says why, or what to do


class WarningLine(QWidget):
    """The doubts of every slot in one line; all of them in whole in the tool tip, which a click shows at once."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setObjectName("warning_line")
        self.text = ""  # all of it, however much there is room for
        self._told: tuple[str, ...] = ()
        self._sign, self._label = StateIcon(), FixedSizeLabel()
        layout = set_spacing(QHBoxLayout(self), 5, (6, 0, 6, 0))
        layout.addWidget(self._sign)
        layout.addWidget(self._label, 1)

    @property
    def visible_text(self) -> str:
        """What there is room for."""
        return self._label.text()

    def show_warnings(self, warnings: Sequence[tuple[str, str]]) -> None:
        """(title of a slot, what is doubted of it), the most telling first."""
        told = tuple(f"{title}: {doubt}" for title, doubt in warnings)
        if told != self._told:
            self._told, self.text = told, _BETWEEN.join(told)
            self.setToolTip("\n".join(told))
            self._sign.show_state("doubtful" if told else "")
            self._fit()

    def resizeEvent(self, a0: Any) -> None:  # noqa: N802
        """As much as there is room for."""
        super().resizeEvent(a0)
        self._fit()

    def mousePressEvent(self, a0: Any) -> None:  # noqa: N802
        """All of it, now."""
        QToolTip.showText(a0.globalPosition().toPoint(), self.toolTip(), self)

    def _fit(self) -> None:
        metrics, layout = self._label.fontMetrics(), self.layout()
        assert layout is not None
        around = layout.contentsMargins()
        room = max(60, self.width() - self._sign.width() - layout.spacing() - around.left() - around.right())
        text = fit_sentences(self._told, lambda words: metrics.horizontalAdvance(words) <= room)
        self._label.setText(metrics.elidedText(text, Qt.TextElideMode.ElideRight, room))


def fit_sentences(sentences: Sequence[str], fits: Callable[[str], bool]) -> str:
    """As many of these sentences as fit, none of them cut: first what is doubted, then why, as far as there is room."""
    brief = [_without_reason(sentence) for sentence in sentences]
    count = next(
        (n for n in range(len(sentences), 1, -1) if fits(_joined(brief[:n], len(sentences)))), min(1, len(sentences))
    )
    shown = brief[:count]
    for i in range(count):
        whole = [*shown[:i], sentences[i], *shown[i + 1 :]]
        if fits(_joined(whole, len(sentences))):
            shown = whole
    return _joined(shown, len(sentences))


def _without_reason(sentence: str) -> str:
    title, _, doubt = sentence.partition(": ")
    return f"{title}: {_A_REASON.split(doubt, maxsplit=1)[0]}"


def _joined(shown: Sequence[str], n_all: int) -> str:
    more = [f"and {n_all - len(shown)} more"] if n_all > len(shown) else []
    return _BETWEEN.join([*shown, *more])
