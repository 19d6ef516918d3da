"""Base of widgets that paint themselves."""

from typing import Any

from PyQt6.QtCore import QSize
from PyQt6.QtGui import QPainter
from PyQt6.QtWidgets import QSizePolicy, QWidget

from widgets.theme import ThemeColours, get_theme_colours

_Policy = QSizePolicy.Policy
GROWS, FIXED, YIELDS = _Policy.Expanding, _Policy.Fixed, _Policy.Ignored  # how a widget takes width or height


class PaintedWidget(QWidget):
    """Paints itself in the theme's colours; subclasses have a preferred size and override `paint`."""

    preferred_px = 200, 160  # width, height

    def __init__(self, name: str = "", description: str = "", across: _Policy = GROWS, down: _Policy = GROWS) -> None:
        """`name` finds the widget, `description` is what a screen reader says."""
        super().__init__()
        self.setObjectName(name)
        self.setAccessibleName(description)
        self.setSizePolicy(across, down)

    def sizeHint(self) -> QSize:  # noqa: N802
        """Return the preferred size."""
        return QSize(*self.preferred_px)

    def paint(self, painter: QPainter, ink: ThemeColours) -> None:
        """Paint in the theme's colours."""
        raise NotImplementedError

    def paintEvent(self, a0: Any) -> None:  # noqa: N802
        """Paint."""
        del a0
        self.paint(QPainter(self), get_theme_colours(self.palette()))
