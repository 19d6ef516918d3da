"""Colour limits that are dragged in a picture are settings of the display, like those of the panel."""

from __future__ import annotations

from PyQt6.QtCore import QObject

from app.frame.instrument import Instrument
from app.session.state import DISPLAY
from pipeline.base.params import changed, settings

_DIGITS = 2  # of a millimetre


class Limits(QObject):
    """Between the colour bars and the session."""

    def __init__(self, instrument: Instrument) -> None:
        super().__init__(instrument)
        self._instrument = instrument
        for column in (*instrument.window.columns.values(), instrument.window.truth):
            column.view.levels.limit_dragged.connect(self.drag)

    def drag(self, name: str, value: float) -> None:
        """Set a limit, as far as it may go; a drag is one undo step."""
        display = self._instrument.session.display
        _, told = settings(display)[name]
        within = min(max(round(value, _DIGITS), told.low), told.high)
        self._instrument.choose_params(DISPLAY, changed(display, name, within))
