"""Small pictures: what a stage has to show can be seen in them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from PyQt6.QtCore import QSize, Qt
from PyQt6.QtGui import QAction, QPalette

from pipeline.views.colours import ColourScale, apply_colour_map
from pipeline.views.preview import Preview
from widgets.timeline.filmstrip import Filmstrip, Thumbnail, render_thumbnail

SCALE = ColourScale(
    colour_map="viridis", low=0.0, high=1.0, unit="mm", quantity="indentation, + toward camera"
)


def _cloud(whole: bool = False) -> Preview:
    """A few pixels in a wide picture that has no value elsewhere, or has one everywhere."""
    values = np.full((140, 175), 0.9 if whole else np.nan, np.float32)
    values[60:75, 90:110] = 0.1
    return Preview(
        pixels=apply_colour_map(values, SCALE),
        frame_name="soft_bubble",
        values=values,
        scale=SCALE,
        pixel_mm=0.4,
    )


def _share(picture: Preview, dense: float = 1.0) -> float:
    """How much of the small picture is what the pixels at 0.1 look like."""
    shown = render_thumbnail(picture, QSize(132, 62), dense, QPalette()).toImage()
    assert (shown.width(), shown.height()) == (132 * dense, 62 * dense)
    wanted = np.array(picture.pixels[65, 100], dtype=int)
    at = [
        shown.pixelColor(x, y)
        for x in range(0, shown.width(), 2)
        for y in range(0, shown.height(), 2)
    ]
    return float(
        np.mean([np.abs(np.subtract((c.red(), c.green(), c.blue()), wanted)).max() < 8 for c in at])
    )


def test_a_few_pixels_fill_a_small_picture_and_a_whole_one_stays_whole(qapp):
    assert _share(_cloud()) > 0.3  # 0.6 of the height, 0.4 of the width
    assert _share(_cloud(), dense=2.0) > 0.3
    assert 0.002 < _share(_cloud(whole=True)) < 0.03
    assert _share(replace(_cloud(whole=True), scale=None, values=None)) < 0.03


def test_a_folded_thumbnail_is_a_line_and_says_its_state(qtbot):
    one = Thumbnail("Adapted cloud")
    qtbot.addWidget(one)
    whole = one.sizeHint().height()
    one.set_collapsed(True)
    one.show_state("warning", "target depth: warning\nseen aslant")
    assert one.sizeHint().height() < whole - 50
    assert "seen aslant" in one.toolTip()


def test_a_click_chooses_a_stage_and_with_control_toggles_it(qtbot):
    strip = Filmstrip({"depth": "2 Depth", "pose": "7 Pose"})
    qtbot.addWidget(strip)
    strip.show()
    said = []
    strip.stage_chosen.connect(lambda stage: said.append(("chosen", stage)))
    strip.stage_toggled.connect(lambda stage: said.append(("toggled", stage)))
    left = Qt.MouseButton.LeftButton
    qtbot.mouseClick(strip.thumbnails["depth"], left)
    qtbot.mouseClick(strip.thumbnails["pose"], left, Qt.KeyboardModifier.ControlModifier)
    assert said == [("chosen", "depth"), ("toggled", "pose")]


def test_a_stage_that_lacks_something_is_a_narrow_card_with_the_button_that_feeds_it(qtbot):
    strip = Filmstrip({"depth": "2 Depth", "pose": "7 Object pose"})
    qtbot.addWidget(strip)
    card = strip.thumbnails["pose"]
    opened = []
    action = QAction("Open mesh…", strip)
    action.triggered.connect(lambda: opened.append(True))
    card.offer_remedy(action)
    strip.resize(900, 120)
    strip.show()
    assert not card.remedy.isVisible()
    card.show_feedable(feedable=True)
    qtbot.waitUntil(lambda: card.width() < strip.thumbnails["depth"].width() / 2)
    qtbot.mouseClick(card.remedy, Qt.MouseButton.LeftButton)
    assert opened


def test_only_trouble_has_a_sign(qtbot):
    one = Thumbnail("2 Depth")
    qtbot.addWidget(one)
    one.resize(160, 110)
    pictures = {}
    for state in ("computed", "cached", "warning", "failed"):
        one.show_state(state, "")
        pictures[state] = one.grab().toImage()
    assert pictures["computed"] == pictures["cached"]
    assert pictures["warning"] != pictures["computed"]
    assert pictures["warning"] != pictures["failed"]
