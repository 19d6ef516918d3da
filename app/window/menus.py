"""Menus, tool bar and drawers."""

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from PyQt6.QtCore import QSize, Qt
from PyQt6.QtGui import QAction
from PyQt6.QtWidgets import (
    QDockWidget,
    QMainWindow,
    QMenu,
    QSizePolicy,
    QToolButton,
    QWidget,
)

from app.window.actions import MENUS, REFERENCE_COMMANDS, THEME_COMMANDS
from widgets.shell.command_bar import CommandBar
from widgets.style.icons import make_command_icon

_TOOLS = (
    "",
    "reset_view",
    "section_line",
    "",
    "show_truth",
    "show_difference",
    "show_wipe",
    "show_blink",
    "",
    "inspector",
)
_AT_RIGHT = ("palette", "full_screen", "export", "live")
_AFTER_SEPARATOR = (
    "open_mesh",
    "save_session",
    "export",
    "quit",
    "reset_all",
    "copy_image",
    "back_10",
    "stage_1",
    "set_variant_settings",
    "edit_alignment",
    "step_through",
    "open_track",
)
# Buttons that get their text next to the icon while there is room, the first ones first.
_TEXT_ORDER = (
    "palette",
    "full_screen",
    "export",
    "live",
    "show_wipe",
    "show_difference",
    "open_recording",
)
_AREA = Qt.DockWidgetArea
_LEAST_SIDE_PX = 290
_SIDE_PX = {_AREA.LeftDockWidgetArea: 360, _AREA.RightDockWidgetArea: _LEAST_SIDE_PX}
_MAX_SIDE_SHARE = 0.2  # of the window's width, for the frames table
# height of the bottom drawer, and its largest share of the window
_BOTTOM_PX = 210
_MAX_BOTTOM_SHARE = 0.25


def build_menus(
    window: QMainWindow,
    actions: Mapping[str, QAction],
    n_columns: int,
    drawers: Iterable[QDockWidget],
) -> dict[str, QMenu]:
    """Create the menus, with every command once; title -> menu."""
    menus = dict[str, QMenu]()
    for text, commands in MENUS.items():
        title = text.replace("&", "")
        menu = menus[title] = QMenu(text, window)
        names = [command.name for command in commands]
        names += [f"stage_{i + 1}" for i in range(n_columns)] if title == "View" else []
        for name in names:
            if name in _AFTER_SEPARATOR:
                menu.addSeparator()
            if name == "open_calibration":
                references = menus["Reference"] = QMenu("Reference", menu)
                references.addActions([actions[command.name] for command in REFERENCE_COMMANDS])
                menu.addMenu(references)
            menu.addAction(actions[name])
        if title == "View":
            menu.addSeparator()
            for drawer in drawers:
                menu.addAction(drawer.toggleViewAction())
            menu.addSeparator()
            menu.addActions([actions[command.name] for command in THEME_COMMANDS])
    return menus


def build_tool_bar(
    window: QMainWindow,
    actions: Mapping[str, QAction],
    menus: Mapping[str, QMenu],
    widgets: Sequence[QWidget],
    drawers: Iterable[QDockWidget],
) -> QToolButton:
    """Create the tool bar: all menus in one button, which is returned, `widgets`, and the tools
    used most.
    """
    bar = CommandBar("Commands", window)
    bar.setObjectName("tool_bar")
    bar.setMovable(False)
    bar.setIconSize(QSize(20, 20))
    window.addToolBar(bar)
    everything = QMenu(bar)
    for title in MENUS:
        everything.addMenu(menus[title.replace("&", "")])
    button = QToolButton()
    button.setObjectName("menu")
    button.setAccessibleName("menu")
    button.setToolTip("All commands (F10)")
    button.setText("\N{TRIGRAM FOR HEAVEN} Menu")
    button.setShortcut("F10")
    button.setMenu(everything)
    button.setPopupMode(QToolButton.ToolButtonPopupMode.InstantPopup)
    spring = QWidget()
    spring.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Preferred)
    for item in (button, "open_recording", *widgets, *_TOOLS, *drawers, spring, *_AT_RIGHT):
        if isinstance(item, QDockWidget):
            bar.addAction(item.toggleViewAction())
        elif isinstance(item, QWidget):
            bar.addWidget(item)
        elif item:
            bar.addAction(actions[item])
        else:
            bar.addSeparator()
    bar.set_text_order([actions[name] for name in _TEXT_ORDER])
    return button


class Drawers(NamedTuple):
    """Frames at the left, alignment at the right, diagnostics at the bottom."""

    frames: QDockWidget
    alignment: QDockWidget
    diagnostics: QDockWidget


def make_drawers(
    window: QMainWindow, frames: QWidget, alignment: QWidget, diagnostics: QWidget
) -> Drawers:
    """Add the drawers to the window, closed."""
    drawers = Drawers(
        _add_drawer(window, "Frames", frames, _AREA.LeftDockWidgetArea, "table", "F2"),
        _add_drawer(window, "Alignment", alignment, _AREA.RightDockWidgetArea, "axes", "F4"),
        _add_drawer(window, "Diagnostics", diagnostics, _AREA.BottomDockWidgetArea, "lines", "F5"),
    )
    window.setCorner(Qt.Corner.BottomLeftCorner, _AREA.LeftDockWidgetArea)
    window.setCorner(Qt.Corner.BottomRightCorner, _AREA.RightDockWidgetArea)
    return drawers


def _add_drawer(
    window: QMainWindow, title: str, widget: QWidget, area: Qt.DockWidgetArea, icon: str, key: str
) -> QDockWidget:
    drawer = QDockWidget(title, window)
    drawer.setObjectName(f"dock_{title.lower()}")
    drawer.setWidget(widget)
    window.addDockWidget(area, drawer)
    drawer.hide()
    action = drawer.toggleViewAction()
    assert action is not None
    action.setIcon(make_command_icon(icon))
    action.setShortcut(key)
    action.setToolTip(f"{title} ({key})")
    action.triggered.connect(lambda: _fit_drawer(window, drawer))
    window.addAction(action)
    return drawer


def _fit_drawer(window: QMainWindow, drawer: QDockWidget) -> None:
    """Raise an opened drawer, and give it its default width or height."""
    if drawer.isHidden():
        return
    drawer.raise_()
    side_px = _SIDE_PX.get(window.dockWidgetArea(drawer))
    if side_px is not None:
        px = min(side_px, max(round(_MAX_SIDE_SHARE * window.width()), _LEAST_SIDE_PX))
        window.resizeDocks([drawer], [px], Qt.Orientation.Horizontal)
    else:
        px = min(_BOTTOM_PX, round(_MAX_BOTTOM_SHARE * window.height()))
        window.resizeDocks([drawer], [px], Qt.Orientation.Vertical)
