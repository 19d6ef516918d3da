"""Layouts as tabs, a tool bar with text where there is room, and one meaning per icon."""

from __future__ import annotations

from itertools import chain

import pytest
from PyQt6.QtCore import Qt
from PyQt6.QtGui import QAction
from PyQt6.QtWidgets import QMainWindow, QToolButton

from app.session.layout import LAYOUT_NAMES
from app.window.actions import MENUS, THEME_COMMANDS
from widgets.shell.command_bar import ActionTabs, CommandBar
from widgets.style.icons import make_command_icon


def _checkable(window, *names):
    actions = [QAction(name, window) for name in names]
    for action in actions:
        action.setCheckable(True)
        action.setToolTip(f"{action.text()} tip")
    return actions


def test_a_tab_runs_its_command_and_a_checked_command_selects_its_tab(qtbot):
    window = QMainWindow()
    qtbot.addWidget(window)
    actions = _checkable(window, "Look", "Align", "Task")
    runs = []
    actions[0].setChecked(True)
    tabs = ActionTabs(actions, "layout")
    qtbot.addWidget(tabs)
    actions[1].triggered.connect(lambda: runs.append("Align"))
    assert [tabs.tabText(i) for i in range(tabs.count())] == ["Look", "Align", "Task"]
    tabs.setCurrentIndex(1)
    assert runs == ["Align"]
    actions[2].setChecked(True)
    actions[1].setChecked(False)
    assert tabs.currentIndex() == 2
    assert runs == ["Align"]


def test_every_layout_is_a_tab_of_the_window(bubble_window):
    window = bubble_window.window
    shown = [window.layout_tabs.tabText(i) for i in range(window.layout_tabs.count())]
    assert shown == [window.actions_by_name[f"layout_{name}"].text() for name in LAYOUT_NAMES]
    window.layout_tabs.setCurrentIndex(shown.index("Align"))
    assert bubble_window.session.layout.name == "align"
    window.actions_by_name["layout_look"].trigger()
    assert window.layout_tabs.currentIndex() == shown.index("Look")


@pytest.mark.parametrize(("width_px", "with_text"), [(900, ["first", "second", "third"]), (60, [])])
def test_tool_buttons_show_text_where_there_is_room(qtbot, width_px, with_text):
    window = QMainWindow()
    qtbot.addWidget(window)
    bar = CommandBar("Commands", window)
    window.addToolBar(bar)
    actions = _checkable(window, "first", "second", "third")
    for action in actions:
        action.setIcon(make_command_icon("save"))
        bar.addAction(action)
    bar.set_text_order(actions)
    bar.resize(width_px, 40)
    bar.fit_texts()
    with_label = Qt.ToolButtonStyle.ToolButtonTextBesideIcon
    buttons = {a.text(): bar.widgetForAction(a) for a in actions}
    assert [
        name for name, button in buttons.items() if button.toolButtonStyle() == with_label
    ] == with_text
    assert all(
        button.focusPolicy() & Qt.FocusPolicy.TabFocus for button in bar.findChildren(QToolButton)
    )


def test_a_tab_that_appears_takes_the_room_of_texts_and_no_button(qtbot):
    window = QMainWindow()
    qtbot.addWidget(window)
    bar = CommandBar("Commands", window)
    window.addToolBar(bar)
    actions = _checkable(window, "Look", "The recordings of a folder, as one table")
    tabs = ActionTabs(actions, "layout")
    bar.addWidget(tabs)
    (live,) = _checkable(window, "Live, from a sensor")
    live.setIcon(make_command_icon("live"))
    bar.addAction(live)
    bar.set_text_order([live])
    window.resize(tabs.sizeHint().width() + 80, 200)
    tabs.offer(actions[1], offered=False)
    window.show()
    button = bar.widgetForAction(live)
    style = Qt.ToolButtonStyle
    qtbot.waitUntil(lambda: button.toolButtonStyle() == style.ToolButtonTextBesideIcon)
    tabs.offer(actions[1], offered=True)
    qtbot.waitUntil(lambda: button.toolButtonStyle() == style.ToolButtonIconOnly)
    qtbot.waitUntil(button.isVisible)


def test_one_icon_has_one_meaning():
    icons = [c.icon for c in chain(*MENUS.values(), THEME_COMMANDS) if c.icon]
    assert len(icons) == len(set(icons)), sorted(icon for icon in icons if icons.count(icon) > 1)


def test_layout_capture_and_registration_tools_are_apart():
    names = {menu.replace("&", ""): {c.name for c in commands} for menu, commands in MENUS.items()}
    assert {f"layout_{name}" for name in LAYOUT_NAMES} <= names["Layout"]
    assert not names["Layout"] & {"set_variant_settings", "step_through", "live", "edit_alignment"}
    assert {"live", "save_screenshot", "copy_image"} <= names["Capture"]
    assert {"step_through", "edit_alignment"} <= names["Registration"]
