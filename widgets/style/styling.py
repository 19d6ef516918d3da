"""Shared styling: fonts, layout spacing, and buttons for commands."""

from collections.abc import Callable
from typing import TypeVar

from PyQt6.QtCore import QEvent, QObject, Qt, QTimer
from PyQt6.QtGui import QAction, QGuiApplication, QPalette
from PyQt6.QtWidgets import (
    QBoxLayout,
    QHBoxLayout,
    QLabel,
    QLayout,
    QLineEdit,
    QPushButton,
    QSplitter,
    QToolButton,
    QVBoxLayout,
    QWidget,
)

from pipeline.views.colours import Rgb
from widgets.style.base import EventListener
from widgets.style.icons import make_command_icon
from widgets.style.theme import ThemeColours, get_theme_colours, to_qcolor

Margins = tuple[int, int, int, int]  # left, top, right, bottom
# an item of a layout, alone or with its shares of the spare room, or empty shares
Item = QWidget | QLayout | int | tuple[QWidget | QLayout, int]
_Layout = TypeVar("_Layout", bound=QLayout)
_Box = TypeVar("_Box", bound=QBoxLayout)
_Widget = TypeVar("_Widget", bound=QWidget)


def set_spacing(layout: _Layout, between_px: int, around_px: Margins = (0, 0, 0, 0)) -> _Layout:
    """Return the layout with this spacing between its items and margins (left, top, right,
    bottom).
    """
    layout.setSpacing(between_px)
    layout.setContentsMargins(*around_px)
    return layout


def fill(layout: _Box, *items: Item) -> _Box:
    """Add widgets and layouts in order.

    (item, n) takes n shares of the spare room, a bare n leaves n shares empty.
    """
    for item in items:
        part, share = item if isinstance(item, tuple) else (item, 0)
        if isinstance(part, int):
            layout.addStretch(part)
        elif isinstance(part, QWidget):
            layout.addWidget(part, share)
        else:
            layout.addLayout(part, share)
    return layout


def make_row(
    gap_px: int, *items: Item, around_px: Margins = (0, 0, 0, 0), on: QWidget | None = None
) -> QHBoxLayout:
    """Return the layout of items beside each other, as `fill` takes them, of a widget or within
    another layout.
    """
    return fill(set_spacing(QHBoxLayout(on), gap_px, around_px), *items)


def make_column(
    gap_px: int, *items: Item, around_px: Margins = (0, 0, 0, 0), on: QWidget | None = None
) -> QVBoxLayout:
    """Return the layout of items under each other."""
    return fill(set_spacing(QVBoxLayout(on), gap_px, around_px), *items)


def make_splitter(way: Qt.Orientation, *items: tuple[QWidget, int]) -> QSplitter:
    """Return a splitter with widgets and the shares of the room that they gain or lose."""
    splitter = QSplitter(way)
    for place, (widget, share) in enumerate(items):
        splitter.addWidget(widget)
        splitter.setStretchFactor(place, share)
    return splitter


def name_widget(widget: _Widget, name: str, description: str = "", tip: str = "") -> _Widget:
    """Return the widget with the name that finds it, what a screen reader says of it, and a
    tooltip.
    """
    widget.setObjectName(name)
    widget.setAccessibleName(description)
    widget.setToolTip(tip)
    return widget


def make_bold(widget: _Widget) -> _Widget:
    """Return the widget with a bold font."""
    font = widget.font()
    font.setBold(True)
    widget.setFont(font)
    return widget


def make_text(*, rich: bool = False, selectable: bool = False) -> QLabel:
    """Return an empty label whose text wraps."""
    label = QLabel()
    label.setWordWrap(True)
    if rich:
        label.setTextFormat(Qt.TextFormat.RichText)
    if selectable:
        label.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
    return label


def make_single_shot_timer(parent: QObject, after_ms: int, then: Callable[[], object]) -> QTimer:
    """Return a timer that calls `then` once, `after_ms` after its last start."""
    timer = QTimer(parent)
    timer.setSingleShot(True)
    timer.setInterval(after_ms)
    timer.timeout.connect(then)
    return timer


def make_command_button(action: QAction) -> QToolButton:
    """Return a flat button for a command."""
    button = QToolButton()
    button.setDefaultAction(action)
    button.setAutoRaise(True)
    return button


def make_button(text: str, name: str, tip: str = "") -> QPushButton:
    """Return a button with a text, an object name and a tooltip."""
    return name_widget(QPushButton(text), name, tip=tip)


def make_line(name: str, description: str, placeholder: str, tip: str = "") -> QLineEdit:
    """Return a line to type in; its placeholder says what."""
    line = name_widget(QLineEdit(), name, description, tip)
    line.setPlaceholderText(placeholder)
    return line


def copy_text(text: str) -> None:
    """Put a text on the clipboard."""
    clipboard = QGuiApplication.clipboard()
    if clipboard is not None:
        clipboard.setText(text)


def make_icon_button(icon: str, name: str, tip: str) -> QToolButton:
    """Return a flat button with an icon, an object name and a tooltip."""
    button = name_widget(QToolButton(), name, tip, tip)
    button.setIcon(make_command_icon(icon))
    button.setAutoRaise(True)
    return button


class ThemedLabel(QLabel):
    """Label in one of the theme's text colours."""

    def __init__(self, ink: Callable[[ThemeColours], Rgb], text: str = "") -> None:
        super().__init__(text)
        self._ink = ink
        self._take_ink()
        EventListener(self, self._take_ink, QEvent.Type.PaletteChange)

    def _take_ink(self) -> None:
        colour = to_qcolor(self._ink(get_theme_colours(self.palette())))
        if self.palette().color(QPalette.ColorRole.WindowText) != colour:
            own = QPalette()
            for group in (QPalette.ColorGroup.Active, QPalette.ColorGroup.Inactive):
                own.setColor(group, QPalette.ColorRole.WindowText, colour)
            self.setPalette(own)


def format_time(ms: float) -> str:
    """Return a computing time in words."""
    if ms < 10:
        return f"{ms:.2f} ms"
    return f"{ms:.0f} ms" if ms < 10_000 else f"{ms / 1e3:.1f} s"
