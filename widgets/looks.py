"""What many widgets have in common: letters, the room in a layout, and buttons for commands."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from PyQt6.QtCore import QEvent, QObject, QTimer
from PyQt6.QtGui import QAction, QPalette
from PyQt6.QtWidgets import QLabel, QLayout, QToolButton, QWidget

from pipeline.pictures.colours import Rgb
from widgets.colours import Inks, inks, qcolor
from widgets.icons import drawn

_Layout = TypeVar("_Layout", bound=QLayout)


def spaced(layout: _Layout, between_px: int, around_px: tuple[int, int, int, int] = (0, 0, 0, 0)) -> _Layout:
    """The layout with this room between what it holds, and around it (left, top, right, bottom)."""
    layout.setSpacing(between_px)
    layout.setContentsMargins(*around_px)
    return layout


def smaller(widget: QWidget, by_pt: float = 1.5, *, least_pt: float = 7.0) -> None:
    """Give a widget smaller letters than the window's, but no smaller than can be read."""
    font = widget.font()
    font.setPointSizeF(max(least_pt, font.pointSizeF() - by_pt))
    widget.setFont(font)


def bold(widget: QWidget) -> None:
    """Give a widget bold letters."""
    font = widget.font()
    font.setBold(True)
    widget.setFont(font)


def once(parent: QObject, after_ms: int, then: Callable[[], object]) -> QTimer:
    """A timer that, each time it is started, calls `then` that much later, counted from its last start."""
    timer = QTimer(parent)
    timer.setSingleShot(True)
    timer.setInterval(after_ms)
    timer.timeout.connect(then)
    return timer


def command_button(action: QAction) -> QToolButton:
    """A flat button for a command of the window."""
    button = QToolButton()
    button.setDefaultAction(action)
    button.setAutoRaise(True)
    return button


def icon_button(icon: str, name: str, tip: str) -> QToolButton:
    """A flat button with a drawn icon, found by its object name, that tells what it does."""
    button = QToolButton()
    button.setIcon(drawn(icon))
    button.setAutoRaise(True)
    button.setObjectName(name)
    button.setToolTip(tip)
    button.setAccessibleName(tip)
    return button


class InkLabel(QLabel):
    """Words in one of the inks of the theme that is on."""

    def __init__(self, ink: Callable[[Inks], Rgb], text: str = "", parent: QWidget | None = None) -> None:
        super().__init__(text, parent)
        self._ink = ink
        self._take_ink()

    def changeEvent(self, a0: QEvent | None) -> None:  # noqa: N802
        """Another theme has another ink."""
        super().changeEvent(a0)
        if a0 is not None and a0.type() == QEvent.Type.PaletteChange:
            self._take_ink()

    def _take_ink(self) -> None:
        colour = qcolor(self._ink(inks(self.palette())))
        if self.palette().color(QPalette.ColorRole.WindowText) != colour:
            own = QPalette()
            for group in (QPalette.ColorGroup.Active, QPalette.ColorGroup.Inactive):
                own.setColor(group, QPalette.ColorRole.WindowText, colour)
            self.setPalette(own)
