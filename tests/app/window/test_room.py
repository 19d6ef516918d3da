"""Nothing is cut off, lies outside what it stands in, or has no room: every layout, on a small
screen and a large one.
"""

from __future__ import annotations

import time

import pytest
from PyQt6.QtCore import QRect, Qt
from PyQt6.QtWidgets import (
    QAbstractButton,
    QAbstractScrollArea,
    QComboBox,
    QDockWidget,
    QLabel,
    QScrollArea,
    QTabBar,
    QWidget,
)

from app.shell.tour import wait_until_shown
from tests.app.window.window_checks import resize_window
from widgets.style.base import FixedSizeLabel

LIMIT_S = 240
SIZES = ((1366, 768), (1600, 950), (2560, 1440))
# of a widget's sides; of a title that ends in dots
LEAST_PX = 8
LEAST_LETTERS = 6


def _scrolled(widget: QWidget) -> bool:
    """Whether it stands in something that can be scrolled, where it may be farther out."""
    above = widget.parentWidget()
    while above is not None:
        if isinstance(above, QAbstractScrollArea):
            return True
        above = above.parentWidget()
    return False


def _faults(window) -> list[str]:
    found = []
    for widget in window.findChildren(QWidget):
        above = widget.parentWidget()
        if not widget.isVisible() or widget.isWindow() or above is None or _scrolled(widget):
            continue
        if isinstance(widget, QTabBar | QDockWidget) and widget.visibleRegion().isEmpty():
            continue  # Qt lays aside what is behind another drawer, and tabs that it does not need
        name = (
            f"{type(widget).__name__} {widget.objectName()!r} in {type(above).__name__} "
            f"{above.objectName()!r}"
        )
        if not QRect(0, 0, above.width(), above.height()).contains(widget.geometry()):
            found.append(f"{name} lies outside: {widget.geometry()} of {above.size()}")
        if isinstance(widget, QScrollArea) and (body := widget.widget()) is not None:
            is_fixed = widget.horizontalScrollBarPolicy() == Qt.ScrollBarPolicy.ScrollBarAlwaysOff
            if is_fixed and body.width() > widget.viewport().width():
                found.append(
                    f"{name} is cut at the right: {body.width()} of {widget.viewport().width()} px"
                )
        has_text = isinstance(widget, QComboBox) or (
            isinstance(widget, QLabel | QAbstractButton) and widget.text()
        )
        if has_text and min(widget.width(), widget.height()) < LEAST_PX:
            found.append(f"{name} has no room: {widget.size()}")
        if (
            isinstance(widget, QAbstractButton)
            and widget.text()
            and widget.width() < widget.minimumSizeHint().width()
        ):
            found.append(f"{name} is cut: {widget.text()!r}")
        if isinstance(widget, FixedSizeLabel) and widget.font().bold():  # a title
            letters = widget.fontMetrics().averageCharWidth() * min(
                LEAST_LETTERS, len(widget.text())
            )
            if widget.width() < letters:
                found.append(f"{name} ends in dots: {widget.text()!r}")
    return found


@pytest.mark.parametrize("layout", ["look", "align"])
def test_nothing_is_cut_off_or_out_of_place(bubble_window, qtbot, layout):
    window = bubble_window.window
    window.actions_by_name[f"layout_{layout}"].trigger()
    assert wait_until_shown(bubble_window, LIMIT_S)
    for size in SIZES:
        for drawers in ((), (window.drawers.diagnostics,), tuple(window.drawers)):
            for drawer in drawers:
                drawer.show()
            resize_window(window, size, qtbot)
            end_s = time.monotonic() + 20.0
            while (faults := _faults(window)) and time.monotonic() < end_s:
                qtbot.wait(10)  # it is being laid out
            assert not faults, f"{size}, {len(drawers)} drawers: " + "\n".join(faults)
            for drawer in drawers:
                drawer.hide()
