"""Themes: what is written and drawn can be read on either ground."""

from __future__ import annotations

from dataclasses import fields
from itertools import product

import numpy as np
import pytest
from PyQt6.QtCore import QSize, Qt
from PyQt6.QtGui import QIcon, QPalette
from PyQt6.QtWidgets import (
    QApplication,
    QCheckBox,
    QComboBox,
    QLineEdit,
    QSlider,
    QSpinBox,
    QWidget,
)

from pipeline.views.colours import NO_VALUE_COLOUR, ColourScale, apply_colour_map, get_colour_table
from pipeline.views.preview import Preview
from widgets.style.icons import DRAWINGS, make_command_icon
from widgets.style.plain_text_style import PlainTextStyle
from widgets.style.styling import ThemedLabel
from widgets.style.theme import get_theme_colours, is_dark, make_palette, use_palette
from widgets.views.canvas import Canvas
from widgets.views.colour_bar import ColourBar

LEAST = 4.5  # WCAG 2.1 for words
_ROLE = QPalette.ColorRole


@pytest.fixture
def themes(qapp):
    """Puts a theme on for the time of a test."""
    yield lambda dark: use_palette(dark=dark)
    use_palette(dark=False)


def contrast(one, other):
    """How far two colours stand apart, 1 to 21, as WCAG 2.1 measures it."""
    brighter, darker = sorted((_luminance(one), _luminance(other)), reverse=True)
    return (brighter + 0.05) / (darker + 0.05)


def _luminance(colour):
    linear = [
        c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4
        for c in (v / 255 for v in colour)
    ]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def _grounds(palette):
    return [
        palette.color(role).getRgb()[:3] for role in (_ROLE.Window, _ROLE.Base, _ROLE.AlternateBase)
    ]


@pytest.mark.parametrize("dark", [False, True])
def test_words_and_signs_stand_out_from_every_ground(dark):
    palette = make_palette(dark=dark)
    ink = get_theme_colours(palette)
    assert is_dark(palette) == dark
    words = {
        "soft": ink.secondary_text,
        "alarm": ink.warning_text,
        "warning": ink.warning_mark,
        "icon": ink.icon,
    }
    words |= dict(zip("xyz", ink.axes, strict=True)) | dict(ink.states)
    words |= {
        role.name: palette.color(role).getRgb()[:3]
        for role in (_ROLE.Text, _ROLE.PlaceholderText, _ROLE.Link)
    }
    for (name, colour), ground in product(words.items(), [*_grounds(palette), ink.backdrop]):
        assert contrast(colour, ground) >= LEAST, (name, colour, ground)
    pairs = (
        (_ROLE.ButtonText, _ROLE.Button),
        (_ROLE.ToolTipText, _ROLE.ToolTipBase),
        (_ROLE.WindowText, _ROLE.Window),
        (_ROLE.BrightText, _ROLE.Window),
    )
    for pair in pairs:
        assert contrast(*(palette.color(role).getRgb()[:3] for role in pair)) >= LEAST, pair
    picked = [palette.color(role).getRgb()[:3] for role in (_ROLE.Highlight, _ROLE.HighlightedText)]
    assert contrast(*picked) >= LEAST
    for bar in (ink.accent, ink.worse, ink.neutral, ink.gauge):  # shapes: 3 to 1
        assert all(contrast(bar, ground) >= 3.0 for ground in _grounds(palette))


@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize("seen", ["protan", "deutan"])
def test_who_sees_no_red_or_no_green_tells_better_from_worse(dark, seen):
    """Brettel's planes as Vienot, Brettel and Mollon (1999) give them for linear light."""
    planes = {
        "protan": [[0.11238, 0.88762, 0.0], [0.11238, 0.88762, 0.0], [0.00401, -0.00401, 1.0]],
        "deutan": [[0.29275, 0.70725, 0.0], [0.29275, 0.70725, 0.0], [-0.02234, 0.02234, 1.0]],
    }
    ink = get_theme_colours(make_palette(dark=dark))
    one, other = (
        np.array(planes[seen]) @ (np.array(c) / 255) ** 2.2 for c in (ink.accent, ink.worse)
    )
    assert np.abs(one ** (1 / 2.2) - np.clip(other, 0, 1) ** (1 / 2.2)).max() > 0.35


@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize("kind", [QCheckBox, QSlider, QLineEdit, QSpinBox, QComboBox])
def test_the_outline_of_a_control_stands_out_from_the_window(themes, qtbot, dark, kind):
    """3 to 1, as WCAG 2.1 asks for the shapes of controls.

    Fusion's own outline is darker than a dark window.
    """
    # drops the palettes of single kinds, which a change of theme sets again
    QApplication.setStyle(PlainTextStyle())
    themes(not dark)
    themes(dark)
    ground = QWidget()
    qtbot.addWidget(ground)
    control = kind(ground)
    if isinstance(control, QSlider):
        control.setOrientation(Qt.Orientation.Horizontal)
    control.resize(60, 24)
    ground.resize(60, 24)
    image = ground.grab().toImage()
    window = make_palette(dark=dark).color(_ROLE.Window).getRgb()[:3]
    # across the left edge
    seen = [contrast(image.pixelColor(x, 12).getRgb()[:3], window) for x in range(12)]
    assert max(seen) >= 3.0
    assert contrast(image.pixelColor(0, 0).getRgb()[:3], window) < 1.1


def test_every_ink_has_both_themes():
    light, dark = (get_theme_colours(make_palette(dark=on)) for on in (False, True))
    assert {path.stem for path in DRAWINGS.glob("state_*.svg")} == {
        f"state_{state}" for state in light.states
    }
    same = [f.name for f in fields(light) if getattr(light, f.name) == getattr(dark, f.name)]
    assert not same
    assert light.states.keys() == dark.states.keys()


@pytest.mark.parametrize(
    "name", [path.stem for path in DRAWINGS.glob("*.svg") if not path.stem.startswith("state_")]
)
def test_icons_are_drawn_in_the_ink_of_the_theme(themes, name):
    icon = make_command_icon(name)
    for dark in (False, True):
        themes(dark)
        image = icon.pixmap(QSize(24, 24)).toImage()
        seen = [image.pixelColor(x, y) for x in range(image.width()) for y in range(image.height())]
        full = [c for c in seen if c.alpha() > 200]
        assert full
        middle = sum(c.lightness() for c in full) / len(full)
        assert middle > 180 if dark else middle < 90


def test_an_icon_of_a_command_that_cannot_be_run_is_faint(themes):
    themes(False)
    icon = make_command_icon("save")
    size = QSize(32, 32)
    most = {
        mode: max(
            icon.pixmap(size, mode).toImage().pixelColor(x, y).alpha()
            for x in range(0, 32, 2)
            for y in range(0, 32, 2)
        )
        for mode in (QIcon.Mode.Normal, QIcon.Mode.Disabled)
    }
    assert most[QIcon.Mode.Disabled] < 0.7 * most[QIcon.Mode.Normal]  # where lines cross


def test_words_follow_the_theme(themes, qtbot):
    label = ThemedLabel(lambda ink: ink.warning_text, "careful")
    qtbot.addWidget(label)
    label.show()
    for dark in (True, False):
        themes(dark)
        qtbot.waitUntil(
            lambda: (
                label.palette().color(_ROLE.WindowText).getRgb()[:3]
                == get_theme_colours(QApplication.palette()).warning_text
            )
        )


def test_pixels_without_a_value_take_the_ground_of_the_theme(themes, qtbot):
    """A grey that stands for nothing would be the brightest thing of a dark window."""
    pixels = np.full((40, 60, 3), NO_VALUE_COLOUR, np.uint8)
    pixels[10:20, 10:20] = (200, 30, 30)
    scale = ColourScale(colour_map="viridis", low=0.0, high=1.0, unit="mm", quantity="depth")
    canvas = Canvas()
    qtbot.addWidget(canvas)
    canvas.resize(120, 80)
    canvas.show()
    canvas.show_preview(Preview(pixels=pixels, frame_name="", scale=scale))
    for dark in (True, False):
        themes(dark)
        ground = get_theme_colours(make_palette(dark=dark)).no_value
        qtbot.waitUntil(lambda: _near(canvas, (100, 60), ground))  # noqa: B023
        assert _near(canvas, (30, 30), (200, 30, 30))
    themes(True)
    # true colours stay as they are
    canvas.show_preview(Preview(pixels=pixels.copy(), frame_name=""))
    assert _near(canvas, (100, 60), NO_VALUE_COLOUR)


def test_signed_values_near_zero_do_not_glare_in_a_dark_window(themes, qtbot):
    """A bubble at rest is white in a light window and dark in a dark one, and so is the middle
    of its colour bar.
    """
    values = np.zeros((40, 60), np.float32)
    scale = ColourScale(colour_map="diverging", low=-1.0, high=1.0, unit="mm", quantity="deviation")
    canvas = Canvas()
    bar = ColourBar()
    for widget, height in ((canvas, 80), (bar, 60)):
        qtbot.addWidget(widget)
        widget.resize(121, height)
        widget.show()
    canvas.show_preview(
        Preview(pixels=apply_colour_map(values, scale), values=values, frame_name="", scale=scale)
    )
    bar.show_scale(scale)
    for dark in (True, False):
        themes(dark)
        centre = tuple(
            int(v) for v in get_colour_table("diverging_dark" if dark else "diverging")[127]
        )
        assert (max(centre) < 45) if dark else (min(centre) > 220)
        qtbot.waitUntil(lambda: _near(canvas, (60, 40), centre))  # noqa: B023
        assert _near(bar, (60, 26), centre)


def _near(canvas, at, colour):
    """Whether a pixel has a colour, but for what a screen of 16 bits rounds."""
    seen = canvas.grab().toImage().pixelColor(*at).getRgb()[:3]
    return max(abs(one - other) for one, other in zip(seen, colour, strict=True)) <= 8
