"""Pictures and the alignment worked by keys alone."""

from __future__ import annotations

import numpy as np
import pytest
from PyQt6.QtCore import Qt
from PyQt6.QtGui import QAction
from PyQt6.QtWidgets import QMainWindow, QPushButton

from app.shell.tour import wait_until_shown
from widgets.views.preview_key_filter import KeyboardFocusFilter

LIMIT_S = 240
_Key = Qt.Key
_How = Qt.KeyboardModifier


@pytest.fixture
def press(bubble_window, qtbot):
    """Presses a key wherever the keyboard is."""
    window = bubble_window.window
    window.activateWindow()
    qtbot.waitUntil(window.isActiveWindow, timeout=240_000)

    def one(key, how=_How.NoModifier, times=1):
        for _ in range(times):
            qtbot.keyClick(window.focusWidget() or window, key, how)

    return one


def test_arrow_keys_move_the_probe_and_tab_changes_the_image(bubble_window, press, qtbot):
    window = bubble_window.window
    frame = bubble_window.session.frame
    press(_Key.Key_P)
    source = window.columns["source"].view
    assert source.canvas.hasFocus()
    press(_Key.Key_Right)
    row, col = source.canvas.crosshair
    press(_Key.Key_Right, times=3)
    press(_Key.Key_Down, _How.ShiftModifier)
    assert source.canvas.crosshair == (row + 10, col + 3)
    assert f"({col + 3}, {row + 10})" in window.trace.text
    press(_Key.Key_Return)
    assert window.actions_by_name["pin_probe"].isChecked()
    press(_Key.Key_Left)  # what is pinned goes along
    assert source.canvas.crosshair == (row + 10, col + 2)
    assert window.actions_by_name["pin_probe"].isChecked()
    press(_Key.Key_Tab)
    assert window.columns["touch"].view.canvas.hasFocus()
    press(_Key.Key_Backtab)
    assert source.canvas.hasFocus()
    scale = source.canvas.scale
    press(_Key.Key_Plus)
    assert source.canvas.scale > scale
    assert bubble_window.session.frame == frame
    press(_Key.Key_Escape)
    assert source.canvas.crosshair is None
    press(_Key.Key_Left)
    assert wait_until_shown(bubble_window, LIMIT_S)
    assert bubble_window.session.frame == frame - 1


def test_arrow_keys_move_the_section_line_and_either_end(bubble_window, press, qtbot):
    press(_Key.Key_X)
    canvas = bubble_window.window.columns["source"].view.canvas
    qtbot.waitUntil(lambda: canvas.line is not None, timeout=240_000)
    press(_Key.Key_P)

    def after(key, how=_How.NoModifier) -> np.ndarray:
        """How far both ends went, in pixels, (2, 2) A and B, right and down."""
        before = canvas.line
        press(key, how)
        qtbot.waitUntil(lambda: canvas.line != before, timeout=240_000)
        return np.array(
            [
                [new.x() - old.x(), new.y() - old.y()]
                for new, old in zip(canvas.line, before, strict=True)
            ]
        )

    for key, how, moved in (
        (_Key.Key_Right, _How.NoModifier, [[1, 0], [1, 0]]),
        (_Key.Key_Down, _How.ControlModifier, [[0, 1], [0, 0]]),
        (_Key.Key_Up, _How.AltModifier | _How.ShiftModifier, [[0, 0], [0, -10]]),
    ):
        # to a hundredth of a millimetre
        np.testing.assert_allclose(after(key, how), moved, atol=0.05)
    assert bubble_window.session.frame == 2


def test_a_button_focused_by_tab_keeps_space_and_enter(qtbot):
    window = QMainWindow()
    qtbot.addWidget(window)
    button = QPushButton("one", window)
    events = []
    window.setCentralWidget(button)
    play = QAction("play", window)
    play.setShortcut("Space")
    play.triggered.connect(lambda: events.append("play"))
    window.addAction(play)
    button.clicked.connect(lambda: events.append("button"))
    KeyboardFocusFilter(window)
    window.show()
    window.activateWindow()
    qtbot.waitUntil(window.isActiveWindow, timeout=240_000)
    for reason in (Qt.FocusReason.TabFocusReason, Qt.FocusReason.MouseFocusReason):
        button.clearFocus()
        button.setFocus(reason)
        qtbot.keyClick(button, _Key.Key_Space)
    button.clearFocus()
    button.setFocus(Qt.FocusReason.TabFocusReason)
    qtbot.keyClick(button, _Key.Key_Return)
    assert events == ["button", "play", "button"]


def test_tab_reaches_every_control_and_tabs_keep_their_keys(bubble_window, press, qtbot):
    """A picture does not hold Tab."""
    window = bubble_window.window
    window.actions_by_name["layout_align"].trigger()
    assert wait_until_shown(bubble_window, LIMIT_S)
    window.drawers.diagnostics.show()
    qtbot.waitUntil(window.alignment.rows["rz"].box.isEnabled, timeout=240_000)
    seen = []
    for _ in range(150):
        press(_Key.Key_Tab)
        now = window.focusWidget()
        assert now is not window.columns["target_depth"].view.canvas
        if seen and now is seen[0]:
            break
        seen.append(now)
    assert window.focusWidget() is seen[0], "Tab never comes round"
    assert {window.tabs.tabBar(), window.alignment.rows["rz"].box, window.timeline.number} <= set(
        seen
    )
    tabs = window.tabs.tabBar()
    shown = window.tabs.currentIndex()
    tabs.setFocus(Qt.FocusReason.TabFocusReason)
    press(_Key.Key_Right)
    assert window.tabs.currentIndex() == shown + 1
    tabs.clearFocus()
    tabs.setFocus(Qt.FocusReason.MouseFocusReason)  # by a click: the window keeps its keys
    frame = bubble_window.session.frame
    press(_Key.Key_Left)
    assert wait_until_shown(bubble_window, LIMIT_S)
    assert bubble_window.session.frame == frame - 1


def test_wipe_and_alignment_work_by_keyboard(bubble_window, press, qtbot):
    window = bubble_window.window
    view = window.columns["source"].view
    press(_Key.Key_P)
    view.overlay.show_wipe(view.preview)
    share = view.overlay.share
    press(_Key.Key_Comma, times=2)
    assert view.overlay.share == pytest.approx(share - 0.1)
    press(_Key.Key_P)
    assert not view.canvas.hasFocus()
    press(_Key.Key_A)
    box = window.alignment.rows["x"].box
    qtbot.waitUntil(box.hasFocus, timeout=240_000)
    for key in (_Key.Key_1, _Key.Key_Period, _Key.Key_5, _Key.Key_Return):
        press(key)
    qtbot.waitUntil(
        lambda: bubble_window.session.offsets.translation_mm[0] == pytest.approx(1.5),
        timeout=240_000,
    )
    qtbot.waitUntil(lambda: not box.hasFocus(), timeout=240_000)
    assert wait_until_shown(bubble_window, LIMIT_S)
