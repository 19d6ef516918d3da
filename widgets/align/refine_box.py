"""Refinement of an alignment: button, progress, result, and accept or reject."""

import math
from collections.abc import Callable
from html import escape

from PyQt6.QtCore import QEvent
from PyQt6.QtWidgets import QHBoxLayout, QVBoxLayout, QWidget

from pipeline.core.arrays import Doubles
from pipeline.translation.alignment.refine import AlignmentFit, Refinement
from pipeline.views.colours import Rgb
from widgets.style.base import EventListener
from widgets.style.run_bar import StartBar
from widgets.style.styling import fill, make_button, make_text, set_spacing
from widgets.style.theme import ThemeColours, get_theme_colours, to_hex

_IDLE = "least squares over all frames with contact on both sensors; a quarter is held out"


class RefineBox(QWidget):
    """Start over message or result over the choice to accept or discard it."""

    def __init__(self) -> None:
        super().__init__()
        self.run_bar = StartBar("refine", "Refine on all frames")
        self.text = make_text(rich=True, selectable=True)
        self.accept = make_button(
            "Accept", "refine_accept", "Use the refined alignment (one undo step)"
        )
        self.discard = make_button("Discard", "refine_discard", "Keep the alignment as it is")
        self.run_bar.start_button.setToolTip(_IDLE[0].upper() + _IDLE[1:])
        choice = fill(QHBoxLayout(), self.accept, self.discard)
        fill(set_spacing(QVBoxLayout(self), 4), self.run_bar, self.text, choice)
        EventListener(self, lambda: self._say(self._format_mm), QEvent.Type.PaletteChange)
        self.show_message()

    def show_message(self, note: str = _IDLE) -> None:
        """Show what runs, or that refinement can start."""
        self._offer_choice(False)
        self._say(lambda ink: _in(ink.secondary_text, note))

    def show_result(self, answer: Refinement, target: str) -> None:
        """Show agreement before and after, unobservable directions, and the choice."""
        self._offer_choice(True)
        self._say(lambda ink: _table(answer, ink) + _words(answer, target, ink))

    def _say(self, make_text: Callable[[ThemeColours], str]) -> None:
        self._format_mm = make_text
        self.text.setText(make_text(get_theme_colours(self.palette())))

    def _offer_choice(self, offered: bool) -> None:
        for button in (self.accept, self.discard):
            button.setVisible(offered)
        self.run_bar.setHidden(offered)


def _in(colour: Rgb, text: str) -> str:
    return f"<span style='color:{to_hex(colour)}'>{escape(text)}</span>"


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
            f"<tr><td>{before.n_touches} "
            f"{name}&nbsp;</td>{_cell(before.surface_mm, after.surface_mm)}"
            f"{_cell(before.outline_mm, after.outline_mm)}</tr>"
        )
    return f"<table width='100%' cellspacing='2'>{''.join(rows)}</table>"


def _cell(before: float, after: float) -> str:
    return f"<td align='right'>{_format_mm(before)} → <b>{_format_mm(after)}</b></td>"


def _format_mm(value: float) -> str:
    return f"{value:.3f}" if math.isfinite(value) else "-"


def _words(answer: Refinement, target: str, ink: ThemeColours) -> str:
    turn = answer.std[:3]
    shift = answer.std[3:]
    lines = [
        f"predicted standard deviation of observable directions, {escape(target)} frame: "
        f"{_format_axes(('x', 'y', 'z'), shift, 3)} mm; "
        f"{_format_axes(('rx', 'ry', 'rz'), turn, 2)}°",
        *(
            _in(ink.warning_text, f"not observable: {words}; unchanged")
            for words in answer.weak_directions
        ),
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
    worse = [
        n
        for n in ("surface_mm", "outline_mm")
        if getattr(after, n) > 1.1 * getattr(before, n) + 0.01
    ]
    return (
        f"held-out touches fit worse than before ({worse[0].removesuffix('_mm')})" if worse else ""
    )


def _format_axes(names: tuple[str, str, str], values: Doubles, digits: int) -> str:
    return ", ".join(
        f"{name} {value:.{digits}f}" for name, value in zip(names, values, strict=True)
    )
