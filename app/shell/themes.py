"""Colour themes: light, dark, or the desktop's."""

from functools import partial
from typing import get_args

from PyQt6.QtCore import Qt
from PyQt6.QtGui import QActionGroup, QGuiApplication

from app.document.autosave import AutosaveController
from app.document.feature import Feature
from app.document.session_controller import SessionController
from app.session.preferences import Theme
from widgets.style.theme import use_palette


def apply_theme(theme: Theme) -> None:
    """Set the palette of the application."""
    hints = QGuiApplication.styleHints()
    is_system_dark = (
        theme == "system" and hints is not None and hints.colorScheme() == Qt.ColorScheme.Dark
    )
    use_palette(dark=theme == "dark" or is_system_dark)


class ThemeController(Feature):
    """Connects the theme commands with the palette and the preferences."""

    def __init__(
        self, controller: SessionController, autosave: AutosaveController, theme: Theme
    ) -> None:
        super().__init__(controller)
        self._autosave = autosave
        self.theme: Theme = theme
        group = QActionGroup(self)
        for name in get_args(Theme):
            action = controller.window.actions_by_name[f"theme_{name}"]
            group.addAction(action)
            action.setChecked(name == theme)
            action.triggered.connect(partial(self.choose_theme, name))
        hints = QGuiApplication.styleHints()
        if hints is not None:
            hints.colorSchemeChanged.connect(self._apply)

    def choose_theme(self, theme: Theme, _checked: bool = False) -> None:
        """Apply a theme, also at the next start."""
        self.theme = theme
        self._autosave.preferences.theme = theme
        self._apply()

    def _apply(self) -> None:
        apply_theme(self.theme)
        self._views.update_captions(self._session)
