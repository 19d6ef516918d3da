"""What many widgets have in common: letters, the room in a layout, and buttons for commands."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from PyQt6.QtCore import QEvent, QObject, QTimer
from PyQt6.QtGui import QAction, QPalette
from PyQt6.QtWidgets import QLabel, QLayout, QToolButton, QWidget

from pipeline.previews.colours import Rgb
from widgets.icons import make_command_icon
from widgets.theme import ThemeColours, get_theme_colours, to_qcolor

_Layout = TypeVar("_Layout", bound=QLayout)


def set_spacing(layout: _Layout, between_px: int, around_px: tuple[int, int, int, int] = (0, 0, 0, 0)) -> _Layout:
    """The layout with this room between what it holds, and around it (left, top, right, bottom)."""
    layout.setSpacing(between_px)
    layout.setContentsMargins(*around_px)
    return layout


def shrink_font(widget: QWidget, by_pt: float = 1.5, *, least_pt: float = 7.0) -> None:
    """Give a widget smaller letters than the window's, but no smaller than can be read."""
    font = widget.font()
    font.setPointSizeF(max(least_pt, font.pointSizeF() - by_pt))
    widget.setFont(font)


def make_bold(widget: QWidget) -> None:
    """Give a widget bold letters."""
    font = widget.font()
    font.setBold(True)
    widget.setFont(font)


def make_single_shot_timer(parent: QObject, after_ms: int, then: Callable[[], object]) -> QTimer:
    """A timer that, each time it is started, calls `then` that much later, counted from its last start."""
    timer = QTimer(parent)
    timer.setSingleShot(True)
    timer.setInterval(after_ms)
    timer.timeout.connect(then)
    return timer


def make_command_button(action: QAction) -> QToolButton:
    """A flat button for a command of the window."""
    button = QToolButton()
    button.setDefaultAction(action)
    button.setAutoRaise(True)
    return button


def make_icon_button(icon: str, name: str, tip: str) -> QToolButton:
    """A flat button with a drawn icon, found by its object name, that tells what it does."""
    button = QToolButton()
    button.setIcon(make_command_icon(icon))
    button.setAutoRaise(True)
    button.setObjectName(name)
    button.setToolTip(tip)
    button.setAccessibleName(tip)
    return button


class ThemedLabel(QLabel):
    """Words in one of the inks of the theme that is on."""

    def __init__(self, ink: Callable[[ThemeColours], Rgb], text: str = "", parent: QWidget | None = None) -> None:
        super().__init__(text, parent)
        self._ink = ink
        self._take_ink()

    def changeEvent(self, a0: QEvent | None) -> None:  # noqa: N802
        """Another theme has another ink."""
        super().changeEvent(a0)
        if a0 is not None and a0.type() == QEvent.Type.PaletteChange:
            self._take_ink()

    def _take_ink(self) -> None:
        colour = to_qcolor(self._ink(get_theme_colours(self.palette())))
        if self.palette().color(QPalette.ColorRole.WindowText) != colour:
            own = QPalette()
            for group in (QPalette.ColorGroup.Active, QPalette.ColorGroup.Inactive):
                own.setColor(group, QPalette.ColorRole.WindowText, colour)
            self.setPalette(own)
