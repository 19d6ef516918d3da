"""Light, dark, or as the desktop says: chosen by a command, remembered, followed at once."""

from __future__ import annotations

from functools import partial
from typing import get_args

from PyQt6.QtCore import QObject, Qt
from PyQt6.QtGui import QActionGroup, QGuiApplication
from PyQt6.QtWidgets import QApplication, QToolTip

from app.session.preferences import Theme
from app.window.autosave import AutosaveController
from app.window.session_controller import SessionController
from widgets.theme import make_palette


def apply_theme(theme: Theme) -> None:
    """Colour every window so; widgets draw themselves anew."""
    hints = QGuiApplication.styleHints()
    system = theme == "system" and hints is not None and hints.colorScheme() == Qt.ColorScheme.Dark
    palette = make_palette(dark=theme == "dark" or system)
    if palette != QApplication.palette():
        QApplication.setPalette(palette)
        QToolTip.setPalette(palette)


class ThemeController(QObject):
    """Between the commands and the palette."""

    def __init__(self, controller: SessionController, keeping: AutosaveController, theme: Theme) -> None:
        super().__init__(controller)
        self._controller, self._keeping = controller, keeping
        self.theme: Theme = theme
        group = QActionGroup(self)
        for name in get_args(Theme):
            action = controller.window.actions_by_name[f"theme_{name}"]
            group.addAction(action)
            action.setChecked(name == theme)
            action.triggered.connect(partial(self.choose_theme, name))
        hints = QGuiApplication.styleHints()
        if hints is not None:
            hints.colorSchemeChanged.connect(self._follow)

    def choose_theme(self, theme: Theme, _checked: bool = False) -> None:
        """Colour the window so from now on, and at the next start."""
        self.theme = theme
        self._keeping.preferences.theme = theme
        self._follow()

    def _follow(self) -> None:
        apply_theme(self.theme)
        self._controller.views.update_captions(self._controller.session)
