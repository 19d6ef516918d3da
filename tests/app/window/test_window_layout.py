"""How the window shares its room: the pictures get it, drawers wait behind their rail."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from PyQt6.QtCore import QRect, QSize, Qt

from app.shell.tour import wait_until_shown
from app.window.main_window import MainWindow


def test_captions_under_3d_views_shorten_with_the_room(bubble_window, qtbot):
    window = bubble_window.window
    caption = window.scene_panel.caption
    window.resize(1900, 1000)
    qtbot.waitUntil(lambda: "frame" in caption.text(), timeout=240_000)
    window.resize(1366, 768)
    for drawer in window.drawers:
        drawer.toggleViewAction().trigger()
    qtbot.waitUntil(lambda: "frame" not in caption.text(), timeout=240_000)
    assert all(c.caption.sizeHint().width() <= c.width() for c in window.view_panels.values())
    assert "frame" in caption.toolTip()


def test_drawers_start_closed_and_open_by_command_and_key(bubble_window, qtbot):
    window = bubble_window.window
    drawers = window.drawers
    assert not any(drawer.isVisible() for drawer in drawers)
    window.activateWindow()
    qtbot.waitUntil(window.isActiveWindow, timeout=240_000)
    qtbot.keyClick(window, Qt.Key.Key_F2)
    qtbot.waitUntil(drawers.frames.isVisible, timeout=240_000)
    drawers.alignment.toggleViewAction().trigger()
    # In front of what shares its place.
    qtbot.waitUntil(lambda: not drawers.alignment.visibleRegion().isEmpty(), timeout=240_000)
    drawers.alignment.toggleViewAction().trigger()
    assert not drawers.alignment.isVisible()


def test_a_window_that_fills_a_small_screen_does_not_grow_with_its_drawers(bubble_window, qtbot):
    window = bubble_window.window
    small = QSize(1366, 768)
    window.resize(small)
    qtbot.waitUntil(lambda: window.size() == small, timeout=240_000)
    for drawer in window.drawers:
        drawer.toggleViewAction().trigger()
        qtbot.wait(150)
        assert window.size() == small, drawer.objectName()


def test_the_window_is_no_larger_than_its_screen(open_window):
    window = open_window().window
    available = window.screen().availableSize()
    assert window.width() <= available.width()
    assert window.height() <= available.height()


@pytest.mark.parametrize(
    ("size", "is_tight"), [((1366, 768), True), ((1600, 950), True), ((1920, 1200), False)]
)
def test_a_first_start_lies_inside_the_screen(open_window, monkeypatch, size, is_tight):
    """With the title bar that the desktop adds: where that has no room, the desktop fits the
    window by maximising it.
    """
    room = QRect(0, 0, *size)
    screen = SimpleNamespace(availableSize=room.size, availableGeometry=lambda: room)
    monkeypatch.setattr(MainWindow, "screen", lambda _: screen)
    window = open_window().window
    assert room.size().expandedTo(window.size()) == room.size()
    assert window.minimumSizeHint().height() < size[1] - 40
    window.maximize_if_tight()
    assert bool(window.windowState() & Qt.WindowState.WindowMaximized) == is_tight


def test_the_trace_is_visible_with_every_drawer_closed(bubble_window, qtbot):
    window = bubble_window.window
    window.columns["depth"].pixel_hovered.emit("depth", 5, 5)
    qtbot.waitUntil(lambda: bool(window.trace.text), timeout=240_000)
    assert window.trace.isVisible()
    assert wait_until_shown(bubble_window, 60)
