"""Colour limits that are dragged in a picture are settings of the display, like those of the panel."""

from __future__ import annotations

from collections.abc import Mapping

from PyQt6.QtCore import QObject

from app.frame.instrument import Instrument
from app.session.state import DISPLAY
from pipeline.base.params import changed, settings
from pipeline.pictures.display import DisplayParams

_DIGITS = 2  # of a millimetre


class Limits(QObject):
    """Between the colour bars and the session."""

    def __init__(self, instrument: Instrument) -> None:
        super().__init__(instrument)
        self._instrument = instrument
        window = instrument.window
        bars = [column.view.levels for column in (*window.columns.values(), window.truth)]
        for source in (*bars, *(tab.grid for tab in window.compare.tabs.values())):
            source.limit_dragged.connect(self.drag)
            source.limits_fitted.connect(self.fit)

    def drag(self, name: str, value: float) -> None:
        """Set a limit, as far as it may go; a drag is one undo step."""
        self._instrument.choose_params(DISPLAY, _limited(self._instrument.session.display, name, value))

    def fit(self, limits: Mapping[str, float]) -> None:
        """Set limits by what is shown, as one undo step."""
        display = self._instrument.session.display
        for name, value in limits.items():
            display = _limited(display, name, value)
        self._instrument.change("fit colour limits", params={**self._instrument.session.params, DISPLAY: display})


def _limited(display: DisplayParams, name: str, value: float) -> DisplayParams:
    _, told = settings(display)[name]
    return changed(display, name, min(max(round(value, _DIGITS), told.low), told.high))
