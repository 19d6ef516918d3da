"""How the window shares its room: the pictures get it, drawers wait behind their rail."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from PyQt6.QtCore import QRect, QSize, Qt

from app.shell.tour import wait_until_shown
from app.window.main_window import MIN_STRIP_PX, MainWindow
from tests.app.window.window_checks import resize_window

# Width and height in pixels that every picture has at least, by the window's size.
ROOMS = {(1600, 950): (215, 160), (1366, 768): (180, 135)}


def _shown_px(view) -> tuple[float, float]:
    width = min(view.canvas.size().width(), view.canvas.size().height() / view.height_over_width)
    return width, width * view.height_over_width


@pytest.mark.parametrize("size", ROOMS)
def test_every_image_has_its_room(bubble_window, qtbot, size):
    window = bubble_window.window
    window.resize(*size)
    # The width a column has, and no more height than that asks for.
    least = ROOMS[size]

    def roomy() -> bool:
        window.resize(*size)
        return window.size() == QSize(*size) and all(
            shown[0] >= least[0] - 1
            and shown[1] >= min(least[1], least[0] * column.view.height_over_width) - 1
            for column in window.columns.values()
            if (shown := _shown_px(column.view))
        )

    qtbot.waitUntil(roomy, timeout=240_000)


def test_a_bottom_drawer_leaves_room_for_images_in_a_small_window(bubble_window, qtbot):
    window = bubble_window.window
    resize_window(window, (1366, 768), qtbot)
    window.drawers.diagnostics.toggleViewAction().trigger()
    least_px = 162  # wide; 130 while states had a line of their own

    def roomy() -> bool:
        shown = [_shown_px(column.view) for column in window.columns.values()]
        window.resize(1366, 768)
        return window.size() == QSize(1366, 768) and all(
            wide >= least_px and high >= 0.75 * least_px for wide, high in shown
        )

    qtbot.waitUntil(roomy, timeout=240_000)
    assert all(
        column._sign.isVisible() and not column._word.isVisible()
        for column in window.columns.values()
    )
    assert all(column.state in column._sign.toolTip() for column in window.columns.values())
    window.drawers.diagnostics.toggleViewAction().trigger()
    qtbot.waitUntil(
        lambda: all(column._word.isVisible() for column in window.columns.values()), timeout=240_000
    )


def test_captions_under_3d_views_shorten_with_the_room(bubble_window, qtbot):
    window = bubble_window.window
    caption = window.view_panels["depth"].caption
    window.resize(1900, 1000)
    qtbot.waitUntil(lambda: "frame" in caption.text(), timeout=240_000)
    window.resize(1366, 768)
    for drawer in window.drawers.all_drawers:
        drawer.toggleViewAction().trigger()
    qtbot.waitUntil(lambda: "frame" not in caption.text(), timeout=240_000)
    assert all(c.caption.sizeHint().width() <= c.width() for c in window.view_panels.values())
    assert "frame" in caption.toolTip()


def test_the_row_is_as_high_as_its_highest_column(bubble_window, qtbot):
    """All pictures fill their width, and one of them its height too: a note under it takes room
    of its own.
    """
    bubble_window.window.resize(1600, 950)

    def snug() -> bool:
        views = [column.view for column in bubble_window.window.columns.values()]
        spare = [
            view.canvas.size().height() - view.height_over_width * view.canvas.size().width()
            for view in views
        ]
        return -3 < min(spare) < 3

    qtbot.waitUntil(snug, timeout=240_000)


def test_drawers_start_closed_and_open_by_rail_and_key(bubble_window, qtbot):
    window = bubble_window.window
    drawers = window.drawers
    assert not any(drawer.isVisible() for drawer in drawers.all_drawers)
    window.activateWindow()
    qtbot.waitUntil(window.isActiveWindow, timeout=240_000)
    qtbot.keyClick(window, Qt.Key.Key_F3)
    qtbot.waitUntil(drawers.parameters.isVisible, timeout=240_000)
    drawers.alignment.toggleViewAction().trigger()
    # In front of what shares its place.
    qtbot.waitUntil(lambda: not drawers.alignment.visibleRegion().isEmpty(), timeout=240_000)
    drawers.alignment.toggleViewAction().trigger()
    assert not drawers.alignment.isVisible()
    assert {action.text() for action in drawers.rail.actions()} == {
        d.windowTitle() for d in drawers.all_drawers
    }


def test_a_window_that_fills_a_small_screen_does_not_grow_with_its_drawers(bubble_window, qtbot):
    window = bubble_window.window
    small = QSize(1366, 768)
    window.resize(small)
    qtbot.waitUntil(lambda: window.size() == small, timeout=240_000)
    for drawer in window.drawers.all_drawers:
        drawer.toggleViewAction().trigger()
        qtbot.wait(150)
        assert window.size() == small, drawer.objectName()


def test_a_dragged_splitter_keeps_its_place(bubble_window):
    rows = bubble_window.window.rows
    rows.fit_sizes()
    before = rows.sizes()[0]
    rows.moveSplitter(before + 60, 1)
    rows.fit_sizes()
    assert rows.sizes()[0] > before + 20


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
    window = open_window().window
    monkeypatch.setattr(MainWindow, "screen", lambda _: screen)
    window._set_default_size()
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


@pytest.mark.parametrize("height", [768, 950, 1440])
def test_the_error_strip_is_at_most_an_eighth_of_the_window(bubble_window, qtbot, height):
    window = bubble_window.window
    window.show()
    window.resize(round(16 / 9 * height), height)
    qtbot.waitUntil(lambda: window.height() == height, timeout=240_000)
    window.rows.spare_height_changed.emit(2000)
    assert MIN_STRIP_PX < window.timeline.errors.height_px <= height / 8 + 1
