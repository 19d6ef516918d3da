"""Menus, tool bar, and the buttons of the timeline."""

from collections.abc import Iterable, Mapping, Sequence

from PyQt6.QtCore import QSize, Qt
from PyQt6.QtGui import QAction
from PyQt6.QtWidgets import QDockWidget, QLabel, QMainWindow, QMenu, QWidget

from app.window.actions import MENUS, THEME_COMMANDS
from widgets.action_tabs import ActionTabs
from widgets.command_bar import CommandBar, name_extension
from widgets.timeline import Timeline

_TOOLS = (
    "open_recording",
    "open_folder",
    "open_mesh",
    "export",
    "",
    "undo",
    "redo",
    "",
    "link_cameras",
    "reset_view",
    "pin_probe",
    "section_line",
    "",
    "show_truth",
    "show_difference",
    "show_wipe",
    "show_blink",
)
_AFTER_SEPARATOR = frozenset(
    (
        "open_mesh", "save_session", "export", "quit", "reset_all", "copy_image", "back_10", "only_1",
        "toggle_inspect", "save_arrangement", "set_variant_settings", "edit_alignment", "step_through", "open_track",
    )
)  # fmt: skip
# Buttons that get their text next to the icon while there is room, the first ones first.
_TEXT_ORDER = (
    "open_recording", "open_mesh", "pin_probe", "export", "section_line", "show_difference", "show_truth",
    "show_wipe", "show_blink", "link_cameras", "reset_view", "open_folder", "undo", "redo",
)  # fmt: skip


def build_menus(
    window: QMainWindow, actions: Mapping[str, QAction], n_columns: int, drawers: Iterable[QDockWidget]
) -> dict[str, QMenu]:
    """Create the menus, with every command once; title -> menu."""
    bar, menus = window.menuBar(), dict[str, QMenu]()
    assert bar is not None
    name_extension(bar)
    for text, commands in MENUS.items():
        title = text.replace("&", "")
        menu = menus[title] = QMenu(text, bar)
        bar.addMenu(menu)
        names = [command.name for command in commands]
        names += [f"only_{i + 1}" for i in range(n_columns)] if title == "View" else []
        for name in names:
            if name in _AFTER_SEPARATOR:
                menu.addSeparator()
            menu.addAction(actions[name])
        if title == "View":
            menu.addSeparator()
            for drawer in drawers:
                menu.addAction(drawer.toggleViewAction())
            menu.addSeparator()
            menu.addActions([actions[command.name] for command in THEME_COMMANDS])
    return menus


def add_layout_tabs(window: QMainWindow, layouts: Sequence[QAction]) -> ActionTabs:
    """Add one tab per layout at the right of the menu bar, where they take no height."""
    bar = window.menuBar()
    assert bar is not None
    bar.setNativeMenuBar(False)
    tabs = ActionTabs(layouts, "layout")
    bar.setCornerWidget(tabs, Qt.Corner.TopRightCorner)
    return tabs


def build_tool_bar(
    window: QMainWindow, actions: Mapping[str, QAction], choosers: Sequence[tuple[str, QWidget]], timeline: Timeline
) -> None:
    """Create the tool bar with `choosers` (label, widget), and the buttons of the timeline."""
    bar = CommandBar("Commands", window)
    bar.setObjectName("tool_bar")
    bar.setMovable(False)
    bar.setIconSize(QSize(20, 20))
    window.addToolBar(bar)
    for name in _TOOLS:
        if name:
            bar.addAction(actions[name])
        else:
            bar.addSeparator()
    bar.addSeparator()
    for label, box in choosers:
        word = QLabel(f"  {label} ")
        word.setBuddy(box)
        bar.addWidget(word)
        bar.addWidget(box)
    bar.set_text_order([actions[name] for name in _TEXT_ORDER])
    for name in ("first", "previous", "play", "next", "last"):
        timeline.add_command(actions[name])
    timeline.add_command(actions["loop"])
