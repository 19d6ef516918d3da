"""Command palette, wheel and keyboard focus, and random input."""

from __future__ import annotations

import logging
import os
import random

from PyQt6.QtCore import QPoint, QPointF, Qt
from PyQt6.QtGui import QWheelEvent
from PyQt6.QtTest import QTest
from PyQt6.QtWidgets import QApplication, QComboBox, QMenu, QWidget

from app.window.actions import MENUS, THEME_COMMANDS
from app.window.tour import wait_until_shown
from pipeline.base.params import list_settings
from pipeline.cli.terminal import print_line
from pipeline.translation.catalogue import BUILT_IN
from tests.app.window.monkey import Monkey
from widgets.command_palette import CommandPalette

LIMIT_S = 240
_MINUTES_OF_LOADING = 5.0  # networks and libraries load meanwhile; memory is judged in longer runs


def wheel(widget) -> QWheelEvent:
    at = QPointF(widget.rect().center())
    return QWheelEvent(
        at, widget.mapToGlobal(at), QPoint(0, 0), QPoint(0, -120), Qt.MouseButton.NoButton,
        Qt.KeyboardModifier.NoModifier, Qt.ScrollPhase.NoScrollPhase, False,
    )  # fmt: skip


def test_every_command_is_in_a_menu_and_in_the_palette(bubble_window):
    window = bubble_window.window
    in_menus = {a.objectName() for menu in window.menuBar().findChildren(QMenu) for a in menu.actions()}
    assert {c.name for commands in (*MENUS.values(), THEME_COMMANDS) for c in commands} <= in_menus
    window.actions_by_name["palette"].trigger()
    palette = window.findChild(CommandPalette)
    assert palette.isVisible()
    assert palette.results.count() >= len(window.actions_by_name) - 1
    assert {"Ctrl+K", "Ctrl+Shift+P"} == {k.toString() for k in window.actions_by_name["palette"].shortcuts()}


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
    window.drawers.parameters.show()
    before, boxes = bubble_window.session, window.findChildren(QComboBox)
    assert len(boxes) > 3
    for control in (*boxes, window.timeline.slider, window.timeline.number):
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
    tips = [w.toolTip() for w in panel.findChildren(QComboBox.__base__) if "gel_limit_mm" in w.objectName()]
    assert any("0.1 to 3 mm" in tip for tip in tips)


def test_parameter_tooltips_state_meaning_unit_range_and_source(bubble_window):
    panel = bubble_window.window.parameters
    for stage in BUILT_IN.stages:
        for method in stage.methods:
            for name, (value, setting) in list_settings(method.params()).items():
                tip = panel.findChild(QWidget, f"{method.key}.{name}").toolTip()
                lines = tip.split("\n")
                assert lines[0].startswith(f"{setting.help} ({stage.name}.{name}"), tip
                assert lines[1] == f"source: {setting.source}"
                if setting.choices:
                    assert ", ".join(setting.choices) in tip
                elif not isinstance(value, bool):
                    assert f"{setting.low:g} to {setting.high:g} {setting.unit}".strip() in tip


def test_random_input_breaks_nothing(open_window, tmp_path, touch_file, ball_file, monkeypatch):
    """Short here; `make monkey` lets it run for an hour."""
    monkeypatch.setattr(logging.getLogger("tactoscope"), "propagate", False)  # pytest would keep every record of it
    window = open_window(touch_file, gl=True, target="gelslim", frame=2)
    assert wait_until_shown(window, LIMIT_S), window.window.banner.text
    seed = int(os.environ.get("MONKEY_SEED", "1"))
    minutes = float(os.environ.get("MONKEY_MINUTES", "0.15"))
    monkey = Monkey(window, random.Random(seed), folder=tmp_path, good=(touch_file, ball_file))
    monkey.play(minutes * 60.0)
    watched = monkey.watched
    print_line(f"seed {seed}, {monkey.n_acts} acts, {watched.panes_looked_at} panes looked at, {watched.solids_drawn} "
          f"3D pictures, {watched.n_cancelled} times cancelled, memory growth {watched.growth_mb():+.0f} MB")  # fmt: skip
    for seconds, process, kept in watched.memory_mb[:: max(1, len(watched.memory_mb) // 20)]:
        print_line(f"{seconds / 60:6.1f} min {process:6.0f} MB, {kept:5.0f} MB of it kept on purpose")
    for complaint in monkey.complaints:
        print_line(complaint)
    assert monkey.complaints == []
    assert monkey.n_acts > 10
    assert watched.solids_drawn > 0
    if minutes > _MINUTES_OF_LOADING:
        assert watched.growth_mb() < 50.0
