"""Colour limits dragged on an image set the display parameters."""

from collections.abc import Mapping

from PyQt6.QtCore import QObject

from app.session.state import DISPLAY_KEY
from app.window.session_controller import SessionController
from pipeline.base.params import list_settings, replace_value
from pipeline.previews.display_params import DisplayParams

_DIGITS = 2  # decimals of a limit in mm


class ColourLimitController(QObject):
    """Connects the colour bars with the session."""

    def __init__(self, controller: SessionController) -> None:
        super().__init__(controller)
        self._controller = controller
        window = controller.window
        bars = [column.view.colour_bar for column in (*window.columns.values(), window.truth_column)]
        for source in (*bars, *(tab.grid for tab in window.comparison.tabs.values())):
            source.limit_dragged.connect(self.set_limit)
            source.limits_fitted.connect(self.set_limits)

    def set_limit(self, name: str, value: float) -> None:
        """Set a limit within its range; a drag is one undo step."""
        self._controller.choose_params(DISPLAY_KEY, _replace_limit(self._controller.session.display, name, value))

    def set_limits(self, limits: Mapping[str, float]) -> None:
        """Set limits fitted to the shown values, as one undo step."""
        display = self._controller.session.display
        for name, value in limits.items():
            display = _replace_limit(display, name, value)
        self._controller.change("fit colour limits", params={**self._controller.session.params, DISPLAY_KEY: display})


def _replace_limit(display: DisplayParams, name: str, value: float) -> DisplayParams:
    _, setting = list_settings(display)[name]
    return replace_value(display, name, min(max(round(value, _DIGITS), setting.low), setting.high))
