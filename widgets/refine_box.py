"""Refinement of an alignment: button, progress, result, and accept or reject."""

from __future__ import annotations

import math
from collections.abc import Callable
from html import escape

from PyQt6.QtCore import QEvent, Qt, pyqtSignal
from PyQt6.QtWidgets import QHBoxLayout, QLabel, QProgressBar, QPushButton, QVBoxLayout, QWidget

from pipeline.alignment.refine import AlignmentFit, Refinement
from pipeline.base.arrays import Doubles
from pipeline.previews.colours import Rgb
from widgets.styling import set_spacing
from widgets.theme import ThemeColours, get_theme_colours, to_hex

_IDLE = "least squares over all frames with contact on both sensors; a quarter is held out"


class RefineBox(QWidget):
    """Emits requests; shows state and result."""

    refine_requested = pyqtSignal()
    cancel_requested = pyqtSignal()
    accepted = pyqtSignal()
    discarded = pyqtSignal()

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.button, self.cancel = _button("Refine on all frames", "refine"), _button("Cancel", "refine_cancel")
        self.accept, self.discard = _button("Accept", "refine_accept"), _button("Discard", "refine_discard")
        self.accept.setToolTip("Use the refined alignment (one undo step)")
        self.discard.setToolTip("Keep the alignment as it is")
        self.button.setToolTip(_IDLE[0].upper() + _IDLE[1:])
        self.bar, self._text = QProgressBar(), QLabel()
        self.bar.setRange(0, 1000)
        self.bar.setTextVisible(False)
        self.bar.setFixedHeight(8)
        self._text.setWordWrap(True)
        self._text.setTextFormat(Qt.TextFormat.RichText)
        self._text.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        layout = set_spacing(QVBoxLayout(self), 4)
        for pair in ((self.button, self.cancel), (self.accept, self.discard)):
            row = QHBoxLayout()
            for one in pair:
                row.addWidget(one)
            layout.addLayout(row)
            if pair[0] is self.button:
                layout.addWidget(self.bar)
                layout.addWidget(self._text)
        self.button.clicked.connect(self.refine_requested)
        self.cancel.clicked.connect(self.cancel_requested)
        self.accept.clicked.connect(self.accepted)
        self.discard.clicked.connect(self.discarded)
        self.show_idle()

    @property
    def text(self) -> str:
        """The message as rich text."""
        return self._text.text()

    def show_idle(self, note: str = _IDLE) -> None:
        """Show that refinement can start."""
        self._show(running=False, done=False)
        self._say(lambda ink: _in(ink.secondary_text, note))

    def show_progress(self, fraction: float, text: str) -> None:
        """Show progress."""
        self._show(running=True, done=False)
        self.bar.setValue(round(1000 * fraction))
        self._say(lambda ink: _in(ink.secondary_text, text))

    def show_result(self, answer: Refinement, target: str) -> None:
        """Show agreement before and after, unobservable directions, and the choice."""
        self._show(running=False, done=True)
        self._say(lambda ink: _table(answer, ink) + _words(answer, target, ink))

    def changeEvent(self, a0: QEvent | None) -> None:  # noqa: N802
        """Use the colours of the new theme."""
        super().changeEvent(a0)
        if a0 is not None and a0.type() == QEvent.Type.PaletteChange:
            self._say(self._format_mm)

    def _say(self, make_text: Callable[[ThemeColours], str]) -> None:
        self._format_mm = make_text
        self._text.setText(make_text(get_theme_colours(self.palette())))

    def _show(self, *, running: bool, done: bool) -> None:
        for widget, seen in (
            (self.button, not running and not done), (self.cancel, running), (self.bar, running),
            (self.accept, done), (self.discard, done),
        ):  # fmt: skip
            widget.setVisible(seen)


def _in(colour: Rgb, text: str) -> str:
    return f"<span style='color:{to_hex(colour)}'>{escape(text)}</span>"


def _button(text: str, name: str) -> QPushButton:
    button = QPushButton(text)
    button.setObjectName(name)
    return button


def _table(answer: Refinement, ink: ThemeColours) -> str:
    rows = [
        f"<tr><td></td><td align='right'>{_in(ink.secondary_text, 'surface mm')}</td>"
        f"<td align='right'>{_in(ink.secondary_text, 'outline mm')}</td></tr>"
    ]
    for name, pair in (("used", answer.used_fit), ("held out", answer.held_out_fit)):
        if pair is None:
            continue
        before, after = pair
        rows.append(
            f"<tr><td>{before.n_touches} {name}&nbsp;</td>{_cell(before.surface_mm, after.surface_mm)}"
            f"{_cell(before.outline_mm, after.outline_mm)}</tr>"
        )
    return f"<table width='100%' cellspacing='2'>{''.join(rows)}</table>"


def _cell(before: float, after: float) -> str:
    return f"<td align='right'>{_format_mm(before)} → <b>{_format_mm(after)}</b></td>"


def _format_mm(value: float) -> str:
    return f"{value:.3f}" if math.isfinite(value) else "-"


def _words(answer: Refinement, target: str, ink: ThemeColours) -> str:
    turn, shift = answer.std[:3], answer.std[3:]
    lines = [
        f"predicted standard deviation of observable directions, {escape(target)} frame: "
        f"{_format_axes(('x', 'y', 'z'), shift, 3)} mm; {_format_axes(('rx', 'ry', 'rz'), turn, 2)}°",
        *(_in(ink.warning_text, f"not observable: {words}; unchanged") for words in answer.weak_directions),
        *(_in(ink.warning_text, note) for note in answer.notes),
    ]
    worse = _worse(answer.held_out_fit)
    if worse:
        lines.append(_in(ink.warning_text, worse))
    return "<br>".join(lines)


def _worse(held_out: tuple[AlignmentFit, AlignmentFit] | None) -> str:
    """Return a warning where held-out touches fit worse than before."""
    if held_out is None:
        return "no touch was left to hold out"
    before, after = held_out
    worse = [n for n in ("surface_mm", "outline_mm") if getattr(after, n) > 1.1 * getattr(before, n) + 0.01]
    return f"held-out touches fit worse than before ({worse[0].removesuffix('_mm')})" if worse else ""


def _format_axes(names: tuple[str, str, str], values: Doubles, digits: int) -> str:
    return ", ".join(f"{name} {value:.{digits}f}" for name, value in zip(names, values, strict=True))
