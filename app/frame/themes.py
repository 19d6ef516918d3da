"""Light, dark, or as the desktop says: chosen by a command, remembered, followed at once."""

from __future__ import annotations

from functools import partial
from typing import get_args

from PyQt6.QtCore import QObject, Qt
from PyQt6.QtGui import QActionGroup, QGuiApplication
from PyQt6.QtWidgets import QApplication, QToolTip

from app.frame.instrument import Instrument
from app.frame.keeping import Keeping
from app.session.remembered import Theme
from widgets.colours import palette_of


def put_on(theme: Theme) -> None:
    """Colour every window so; widgets draw themselves anew."""
    hints = QGuiApplication.styleHints()
    system = theme == "system" and hints is not None and hints.colorScheme() == Qt.ColorScheme.Dark
    palette = palette_of(dark=theme == "dark" or system)
    if palette != QApplication.palette():
        QApplication.setPalette(palette)
        QToolTip.setPalette(palette)


class Themes(QObject):
    """Between the commands and the palette."""

    def __init__(self, instrument: Instrument, keeping: Keeping, theme: Theme) -> None:
        super().__init__(instrument)
        self._instrument, self._keeping = instrument, keeping
        self.chosen: Theme = theme
        group = QActionGroup(self)
        for name in get_args(Theme):
            action = instrument.window.actions_by_name[f"theme_{name}"]
            group.addAction(action)
            action.setChecked(name == theme)
            action.triggered.connect(partial(self.choose, name))
        hints = QGuiApplication.styleHints()
        if hints is not None:
            hints.colorSchemeChanged.connect(self._follow)

    def choose(self, theme: Theme, _checked: bool = False) -> None:
        """Colour the window so from now on, and at the next start."""
        self.chosen = theme
        self._keeping.remembered.theme = theme
        self._follow()

    def _follow(self) -> None:
        put_on(self.chosen)
        self._instrument.screen.caption(self._instrument.session)
