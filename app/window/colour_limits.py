"""Colour limits that are dragged in a picture are settings of the display, like those of the panel."""

from __future__ import annotations

from collections.abc import Mapping

from PyQt6.QtCore import QObject

from app.session.state import DISPLAY_KEY
from app.window.session_controller import SessionController
from pipeline.base.params import list_settings, replace_value
from pipeline.previews.display_params import DisplayParams

_DIGITS = 2  # of a millimetre


class ColourLimitController(QObject):
    """Between the colour bars and the session."""

    def __init__(self, controller: SessionController) -> None:
        super().__init__(controller)
        self._controller = controller
        window = controller.window
        bars = [column.view.colour_bar for column in (*window.columns.values(), window.truth_column)]
        for source in (*bars, *(tab.grid for tab in window.comparison.tabs.values())):
            source.limit_dragged.connect(self.set_limit)
            source.limits_fitted.connect(self.set_limits)

    def set_limit(self, name: str, value: float) -> None:
        """Set a limit, as far as it may go; a drag is one undo step."""
        self._controller.choose_params(DISPLAY_KEY, _limited(self._controller.session.display, name, value))

    def set_limits(self, limits: Mapping[str, float]) -> None:
        """Set limits by what is shown, as one undo step."""
        display = self._controller.session.display
        for name, value in limits.items():
            display = _limited(display, name, value)
        self._controller.change("fit colour limits", params={**self._controller.session.params, DISPLAY_KEY: display})


def _limited(display: DisplayParams, name: str, value: float) -> DisplayParams:
    _, told = list_settings(display)[name]
    return replace_value(display, name, min(max(round(value, _DIGITS), told.low), told.high))
