"""The whole screen, a picture on the clipboard, and the values around a pixel."""

from __future__ import annotations

import pytest
from PyQt6.QtGui import QGuiApplication

from app.window.presentation import PresentationController
from app.window.tour import wait_until_shown
from widgets.magnifier import MAX_RADIUS_PX

LIMIT_S = 240


def test_the_magnifier_reads_what_the_probe_reads_and_stays_clear_of_the_pixel(bubble_window, qtbot):
    window = bubble_window.window
    magnifier = bubble_window.findChild(PresentationController).magnifier
    window.resize(1366, 768)
    depth = window.columns["depth"]
    qtbot.waitUntil(lambda: depth.view.canvas.height() > 120, timeout=240_000)
    depth.pixel_hovered.emit("depth", 60, 70)
    assert not magnifier.isVisible()  # it is off
    window.actions_by_name["magnify"].trigger()
    for row, col in ((60, 70), (0, 0), (130, 10)):
        depth.pixel_hovered.emit("depth", row, col)
        assert magnifier.isVisible()
        assert magnifier.parentWidget() is depth.view.canvas
        assert magnifier.format_value(row, col) == f"{depth.view.preview.values[row, col]:.2f}"
        magnifier.grab()  # it can be painted at the picture's border too
        rows = depth.view.preview.pixels.shape[0]
        assert (magnifier.geometry().center().y() > depth.view.canvas.height() / 2) == (row < rows / 2)
    assert magnifier.format_value(-1, 0) == ""
    assert 1 <= magnifier.radius_px < MAX_RADIUS_PX  # a small picture
    depth.pixel_hovered.emit("depth", -1, -1)
    assert not magnifier.isVisible()
    bubble_window.probe.move_to_pixel("target_depth", 40, 50)  # by keys
    assert magnifier.parentWidget() is window.columns["target_depth"].view.canvas
    window.actions_by_name["magnify"].trigger()
    assert not magnifier.isVisible()


@pytest.mark.parametrize("layout", ["stages", "inspect", "align"])
def test_the_active_pane_is_copied(bubble_window, layout):
    window = bubble_window.window
    window.actions_by_name[f"layout_{layout}"].trigger()
    assert wait_until_shown(bubble_window, LIMIT_S)
    window.actions_by_name["copy_image"].trigger()
    copied = QGuiApplication.clipboard().pixmap()
    whole = window.size()
    assert (copied.width() == whole.width()) == (layout == "stages")
    assert 100 < copied.width() <= whole.width()
    assert f"{copied.width()} x {copied.height()}" in window.readout.text()


def test_the_window_toggles_full_screen(bubble_window, qtbot):
    window, action = bubble_window.window, bubble_window.window.actions_by_name["full_screen"]
    action.trigger()
    qtbot.waitUntil(window.isFullScreen, timeout=240_000)
    action.trigger()
    qtbot.waitUntil(lambda: not window.isFullScreen(), timeout=240_000)
