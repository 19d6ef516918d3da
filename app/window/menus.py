"""Menus, tool bar, and the buttons of the timeline."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from PyQt6.QtCore import QSize, Qt
from PyQt6.QtGui import QAction
from PyQt6.QtWidgets import QDockWidget, QLabel, QMainWindow, QMenu, QToolBar, QToolButton, QWidget

from app.window.actions import (
    COMPARISON_MODE_COMMANDS,
    EDIT_COMMANDS,
    FILE_COMMANDS,
    HELP_COMMANDS,
    LAYOUT_COMMANDS,
    PLAYBACK_COMMANDS,
    THEME_COMMANDS,
    VIEW_COMMANDS,
)
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
    ("open_mesh", "save_session", "export", "quit", "reset_all", "back_10", "show_truth", "only_1")
)
_WITH_TEXT = ("open_recording", "open_mesh", "pin_probe")


def build_menus(
    window: QMainWindow, actions: Mapping[str, QAction], n_columns: int, drawers: Iterable[QDockWidget]
) -> dict[str, QMenu]:
    """Create the menus, with every command once; title -> menu."""
    bar, menus = window.menuBar(), dict[str, QMenu]()
    assert bar is not None
    for title, names in (
        ("&File", [c.name for c in FILE_COMMANDS]),
        ("&Edit", [c.name for c in EDIT_COMMANDS]),
        ("&Play", [c.name for c in PLAYBACK_COMMANDS]),
        (
            "&View",
            [c.name for c in VIEW_COMMANDS + COMPARISON_MODE_COMMANDS] + [f"only_{i + 1}" for i in range(n_columns)],
        ),
        ("&Layout", [c.name for c in LAYOUT_COMMANDS]),
        ("&Help", [c.name for c in HELP_COMMANDS]),
    ):
        menu = bar.addMenu(title)
        assert menu is not None
        menus[title.replace("&", "")] = menu
        for name in names:
            if name in _AFTER_SEPARATOR:
                menu.addSeparator()
            menu.addAction(actions[name])
        if title == "&View":
            menu.addSeparator()
            for drawer in drawers:
                menu.addAction(drawer.toggleViewAction())
            menu.addSeparator()
            menu.addActions([actions[command.name] for command in THEME_COMMANDS])
    return menus


def build_tool_bar(
    window: QMainWindow, actions: Mapping[str, QAction], choosers: Sequence[tuple[str, QWidget]], timeline: Timeline
) -> None:
    """Create the tool bar with `choosers` (label, widget), and the buttons of the timeline."""
    bar = QToolBar("Commands", window)
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
    for name in _WITH_TEXT:
        button = bar.widgetForAction(actions[name])
        if isinstance(button, QToolButton):
            button.setToolButtonStyle(Qt.ToolButtonStyle.ToolButtonTextBesideIcon)
    for name in ("first", "previous", "play", "next", "last"):
        timeline.add_command(actions[name])
    timeline.add_command(actions["loop"])
