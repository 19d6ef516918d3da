"""Light and dark: chosen, remembered, followed, and pictures that have their size at every size
of window.
"""

from __future__ import annotations

import pytest
from PyQt6.QtCore import Qt
from PyQt6.QtGui import QGuiApplication
from PyQt6.QtWidgets import QApplication, QLabel

from app.session.preferences import Preferences
from app.shell import themes as room
from app.shell.tour import wait_until_shown
from widgets.style.theme import get_theme_colours, is_dark, make_palette, to_hex

LIMIT_S = 240


@pytest.fixture(autouse=True)
def as_before(qapp):
    """The palette is the whole program's."""
    before = QApplication.palette()
    yield
    QApplication.setPalette(before)


def test_a_theme_is_chosen_by_a_command_and_saved(open_window, qtbot):
    window = open_window().window
    for name, dark in (("dark", True), ("light", False)):
        window.actions_by_name[f"theme_{name}"].trigger()
        qtbot.waitUntil(lambda dark=dark: is_dark(window.palette()) == dark, timeout=240_000)
        assert window.actions_by_name[f"theme_{name}"].isChecked()
        assert Preferences().theme == name
    assert window.actions_by_name["theme_dark"] in window.menus["View"].actions()


def test_an_invalid_saved_theme_falls_back_to_dark(qapp, remembered_here):
    kept = Preferences()
    kept.theme = "mauve"  # pyright: ignore[reportAttributeAccessIssue]
    assert kept.theme == "dark"


@pytest.mark.parametrize(
    "scheme", [Qt.ColorScheme.Dark, Qt.ColorScheme.Light, Qt.ColorScheme.Unknown]
)
def test_the_systems_theme_is_followed(qapp, monkeypatch, scheme):
    class Hints:
        def colorScheme(self):
            return scheme

    monkeypatch.setattr(QGuiApplication, "styleHints", staticmethod(Hints))
    room.apply_theme("system")
    assert QApplication.palette() == make_palette(dark=scheme == Qt.ColorScheme.Dark)


def test_captions_and_trace_follow_the_theme(bubble_window, qtbot):
    window = bubble_window.window
    bubble_window.probe.toggle_pin("target_depth", 60, 80)
    bubble_window.probe.draw_pending()
    before = bubble_window.views.scene
    window.actions_by_name["theme_dark"].trigger()
    ink = get_theme_colours(make_palette(dark=True))
    assert to_hex(ink.axes[0]) in window.view_panels["touch"].caption.text()
    qtbot.waitUntil(
        lambda: to_hex(ink.secondary_text) in window.trace.findChild(QLabel).text(), timeout=240_000
    )
    assert bubble_window.views.scene is before


@pytest.mark.gl
def test_3d_views_have_the_background_of_the_theme(open_window, touch_file, qtbot):
    controller = open_window(touch_file, gl=True, target="gelslim", frame=2)
    assert wait_until_shown(controller, LIMIT_S)
    controller.window.actions_by_name["stage_3"].trigger()
    scene = controller.views
    qtbot.waitUntil(lambda: hasattr(scene.scene, "n_renders"), timeout=LIMIT_S * 1000)
    for name in ("dark", "light"):
        controller.window.actions_by_name[f"theme_{name}"].trigger()
        ground = get_theme_colours(make_palette(dark=name == "dark")).backdrop
        view = controller.window.view_panels["cloud"].view

        def has_ground(view=view, ground=ground) -> bool:
            return view.image is not None and view.image.pixelColor(2, 2).getRgb()[:3] == ground

        qtbot.waitUntil(has_ground, timeout=240_000)
