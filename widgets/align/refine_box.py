"""Refinement of an alignment: button, progress, result, and accept or reject."""

import math
from collections.abc import Callable
from html import escape

from PyQt6.QtCore import QEvent
from PyQt6.QtWidgets import QWidget

from pipeline.core.arrays import Doubles
from pipeline.translation.alignment.refine import AlignmentFit, Refinement
from pipeline.views.colours import Rgb
from widgets.style.base import EventListener
from widgets.style.run_bar import StartBar
from widgets.style.styling import make_button, make_column, make_row, make_text
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
        choice = make_row(6, self.accept, self.discard)
        make_column(4, self.run_bar, self.text, choice, on=self)
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
    heads = "".join(
        f"<td align='right'>{_in(ink.secondary_text, head)}</td>"
        for head in ("surface mm", "outline mm")
    )
    rows = [f"<tr><td></td>{heads}</tr>"]
    for name, pair in (("used", answer.used_fit), ("held out", answer.held_out_fit)):
        if pair is not None:
            cells = "".join(
                f"<td align='right'>{_format_mm(before)} → <b>{_format_mm(after)}</b></td>"
                for before, after in zip(*map(_list_errors_mm, pair), strict=True)
            )
            rows.append(f"<tr><td>{pair[0].n_touches} {name}&nbsp;</td>{cells}</tr>")
    return f"<table width='100%' cellspacing='2'>{''.join(rows)}</table>"


def _list_errors_mm(fit: AlignmentFit) -> tuple[float, float]:
    return fit.surface_mm, fit.outline_mm


def _format_mm(value: float) -> str:
    return f"{value:.3f}" if math.isfinite(value) else "-"


def _words(answer: Refinement, target: str, ink: ThemeColours) -> str:
    spread = (
        "predicted standard deviation of observable directions, "
        f"{escape(target)} frame: {_format_axes(answer.std[3:], '{} {:.3f}')} mm; "
        f"{_format_axes(answer.std[:3], 'r{} {:.2f}')}°"
    )
    warnings = (
        *(f"not observable: {words}; unchanged" for words in answer.weak_directions),
        *answer.notes,
        _worse(answer.held_out_fit),
    )
    return "<br>".join((spread, *(_in(ink.warning_text, words) for words in warnings if words)))


def _worse(held_out: tuple[AlignmentFit, AlignmentFit] | None) -> str:
    """Return a warning where held-out touches fit worse than before."""
    if held_out is None:
        return "no touch was left to hold out"
    for name, before, after in zip(
        ("surface", "outline"), *map(_list_errors_mm, held_out), strict=True
    ):
        if after > 1.1 * before + 0.01:
            return f"held-out touches fit worse than before ({name})"
    return ""


def _format_axes(values: Doubles, form: str) -> str:
    return ", ".join(form.format(*pair) for pair in zip("xyz", values, strict=True))
