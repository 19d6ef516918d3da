"""Command palette, wheel and keyboard focus."""

from __future__ import annotations

from PyQt6.QtCore import QPoint, QPointF, Qt
from PyQt6.QtGui import QWheelEvent
from PyQt6.QtTest import QTest
from PyQt6.QtWidgets import QApplication, QComboBox, QWidget

from app.shell.tour import wait_until_shown
from app.window.actions import MENUS, THEME_COMMANDS
from pipeline.core.params import list_settings
from pipeline.translation.catalogue import BUILT_IN
from widgets.shell.command_palette import CommandPalette

LIMIT_S = 240


def wheel(widget) -> QWheelEvent:
    at = QPointF(widget.rect().center())
    return QWheelEvent(
        at,
        widget.mapToGlobal(at),
        QPoint(0, 0),
        QPoint(0, -120),
        Qt.MouseButton.NoButton,
        Qt.KeyboardModifier.NoModifier,
        Qt.ScrollPhase.NoScrollPhase,
        False,
    )


def test_every_command_is_in_a_menu_and_in_the_palette(bubble_window):
    window = bubble_window.window
    in_menus = {a.objectName() for menu in window.menus.values() for a in menu.actions()}
    assert {c.name for commands in (*MENUS.values(), THEME_COMMANDS) for c in commands} <= in_menus
    window.actions_by_name["palette"].trigger()
    palette = window.findChild(CommandPalette)
    assert palette.isVisible()
    assert palette.results.count() >= len(window.actions_by_name) - 1
    assert {"Ctrl+K", "Ctrl+Shift+P", "F1"} == {
        k.toString() for k in window.actions_by_name["palette"].shortcuts()
    }


def test_the_palette_finds_commands_by_a_few_letters(bubble_window):
    bubble_window.choose_frame(0)
    bubble_window.window.actions_by_name["palette"].trigger()
    palette = bubble_window.window.findChild(CommandPalette)
    QTest.keyClicks(palette.line, "lst fr")
    assert palette.results.currentItem().text().startswith("Last frame")
    QTest.keyClick(palette.line, Qt.Key.Key_Return)
    assert not palette.isVisible()
    assert bubble_window.session.frame == 2
    assert wait_until_shown(bubble_window, LIMIT_S)


def test_a_wheel_over_an_unfocused_control_changes_nothing(bubble_window):
    window = bubble_window.window
    window.show_inspector()
    before = bubble_window.session
    boxes = window.findChildren(QComboBox)
    assert len(boxes) > 3
    for control in (*boxes, window.timeline.number):
        event = wheel(control)
        QApplication.sendEvent(control, event)
        assert not event.isAccepted() or control.hasFocus(), control.objectName()
    assert bubble_window.session == before
    assert wait_until_shown(bubble_window, LIMIT_S)


def test_enter_accepts_the_number_and_returns_the_focus(bubble_window, qtbot):
    window = bubble_window.window
    window.activateWindow()
    number = window.timeline.number
    number.setFocus()
    number.selectAll()
    QTest.keyClicks(number, "1")
    QTest.keyClick(number, Qt.Key.Key_Return)
    qtbot.waitUntil(lambda: not number.hasFocus(), timeout=240_000)
    assert bubble_window.session.frame == 1
    assert wait_until_shown(bubble_window, LIMIT_S)


def test_parameter_tooltips_state_unit_and_range(bubble_window):
    panel = bubble_window.window.parameters
    tips = [
        w.toolTip()
        for w in panel.findChildren(QComboBox.__base__)
        if "gel_limit_mm" in w.objectName()
    ]
    assert any("(0 to 3 mm)" in tip for tip in tips)


def test_parameter_tooltips_state_meaning_unit_range_and_source(bubble_window):
    panel = bubble_window.window.parameters
    for stage in BUILT_IN.stages:
        for method in stage.methods:
            for name, (value, setting) in list_settings(method.params()).items():
                field = panel.findChild(QWidget, f"{method.key}.{name}")
                tip = field.toolTip()
                if not field.isEnabled():  # of a method that cannot answer here: it says why
                    assert tip.startswith("no network for this pair: "), tip
                    continue
                lines = tip.split("\n")
                assert lines[0].startswith(setting.help), tip
                assert lines[1] == f"source: {setting.source}"
                if setting.choices:
                    offered = tuple(field.itemText(i) for i in range(field.count()))
                    assert offered == setting.choice_titles
                elif not isinstance(value, bool):
                    assert f"{setting.low:g} to {setting.high:g} {setting.unit}".strip() in tip
