"""The window's commands where one finds them: menus, tool bar, and the buttons of the timeline."""

from __future__ import annotations

from typing import TYPE_CHECKING

from PyQt6.QtCore import QSize, Qt
from PyQt6.QtWidgets import QLabel, QToolBar, QToolButton

from app.frame.actions import ARRANGE, EDIT, FILE, HELP, PLAY, VERSUS, VIEW

if TYPE_CHECKING:
    from app.frame.window import Window

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
    "freeze_trace",
    "",
    "show_truth",
    "show_difference",
    "show_wipe",
    "show_blink",
)
_FIRST_OF_THEIR_KIND = frozenset(
    ("open_mesh", "save_session", "export", "quit", "reset_all", "ten_back", "show_truth", "only_1")
)
_NAMED = ("open_recording", "open_mesh", "freeze_trace")


def build_menus(window: Window) -> None:
    """Every command once, by what it is about."""
    bar = window.menuBar()
    assert bar is not None
    for title, names in (
        ("&File", [c.name for c in FILE]),
        ("&Edit", [c.name for c in EDIT]),
        ("&Play", [c.name for c in PLAY]),
        ("&View", [c.name for c in VIEW + VERSUS] + [f"only_{i + 1}" for i in range(len(window.columns))]),
        ("&Layout", [c.name for c in ARRANGE]),
        ("&Help", [c.name for c in HELP]),
    ):
        menu = bar.addMenu(title)
        assert menu is not None
        window.menus[title.replace("&", "")] = menu
        for name in names:
            if name in _FIRST_OF_THEIR_KIND:
                menu.addSeparator()
            menu.addAction(window.actions_by_name[name])
        if title == "&View":
            menu.addSeparator()
            for drawer in window.drawers.all:
                menu.addAction(drawer.toggleViewAction())


def build_tool_bar(window: Window) -> None:
    """What is used most, and which sensors and route."""
    bar = QToolBar("Commands", window)
    bar.setObjectName("tool_bar")
    bar.setMovable(False)
    bar.setIconSize(QSize(20, 20))
    window.addToolBar(bar)
    for name in _TOOLS:
        if name:
            bar.addAction(window.actions_by_name[name])
        else:
            bar.addSeparator()
    bar.addSeparator()
    for label, box in (("source", window.source), ("target", window.target), ("route", window.route)):
        word = QLabel(f"  {label} ")
        word.setBuddy(box)
        bar.addWidget(word)
        bar.addWidget(box)
    for name in _NAMED:  # the others' names are in their tips and in the menus
        button = bar.widgetForAction(window.actions_by_name[name])
        if isinstance(button, QToolButton):
            button.setToolButtonStyle(Qt.ToolButtonStyle.ToolButtonTextBesideIcon)
    for name in ("first", "previous", "play", "next", "last"):
        window.timeline.add_command(window.actions_by_name[name])
    window.timeline.add_command(window.actions_by_name["loop"])
