"""The scene of both sensors in a pane of the window."""

from __future__ import annotations

import numpy as np
import pytest
from PyQt6.QtCore import QPoint, Qt

from app.session.layout import Layout
from app.session.sample import SAMPLE_RECORDING
from app.shell.tour import wait_until_shown
from pipeline.core.geometry import rigid
from pipeline.sensors.alignment import Offsets

LIMIT_S = 240
PANES = (("source", "both"), ("touch_depth", "scene"), ("touch", "both"))


def _count_colours(image) -> int:
    across, down = range(0, image.width(), 3), range(0, image.height(), 3)
    return len({image.pixelColor(x, y).rgb() for x in across for y in down})


def _scene_layers(controller) -> dict:
    place = controller.views.page_views["scene"]
    return {layer.name: layer for layer in controller.views.scene._layers.get(place, ())}


@pytest.mark.gl
def test_the_middle_pane_shows_both_sensors_and_turns(open_window, qtbot):
    controller = open_window(
        SAMPLE_RECORDING, gl=True, source="gelslim", target="soft_bubble", frame=5
    )
    assert wait_until_shown(controller, LIMIT_S), controller.window.banner.text
    assert controller.session.layout.panes == PANES
    view = controller.window.scene_panel.view
    scene = controller.views.scene
    qtbot.waitUntil(lambda: scene.is_open, timeout=LIMIT_S * 1000)
    scene.draw_pending()
    assert view.isVisible()
    assert not controller.window.view_panels["touch_depth"].isVisible()
    assert _count_colours(view.image) > 200
    assert set(view.labels) == {"S", "A", "T"}
    assert {"source", "touch_depth", "recorded", "object"} <= set(_scene_layers(controller))
    image, source = view.image, view.labels["S"]
    at = view.rect().center()
    qtbot.mousePress(view, Qt.MouseButton.LeftButton, pos=at)
    qtbot.mouseMove(view, at + QPoint(60, 30))
    qtbot.mouseRelease(view, Qt.MouseButton.LeftButton, pos=at + QPoint(60, 30))
    scene.draw_pending()
    assert view.image is not image
    assert view.labels["S"] != source


def test_the_scene_follows_offsets_and_is_made_only_in_a_pane(bubble_window):
    controller = bubble_window
    before = _scene_layers(controller)
    moved = Offsets(translation_mm=(1.0, 2.0, 3.0), rotation_deg=(0.0, 0.0, 20.0))
    controller.change("move", offsets=moved)
    assert wait_until_shown(controller, LIMIT_S), controller.window.banner.text
    opened = controller.views.translation
    alignment = moved.apply_to(opened.alignment)
    after = _scene_layers(controller)
    view_from_target = rigid.invert(opened.alignment.target_from_alignment)
    for layers in (before, after):
        np.testing.assert_allclose(layers["touch_depth"].view_from_layer, view_from_target)
    np.testing.assert_allclose(
        after["source membrane"].view_from_layer, view_from_target @ alignment.target_from_source
    )
    controller.window.look.panes[1].dims_chosen.emit("3D")
    controller.change("move back", offsets=Offsets())
    assert wait_until_shown(controller, LIMIT_S), controller.window.banner.text
    assert controller.window.view_panels["touch_depth"].isVisible()
    assert not controller.window.scene_panel.isVisible()
    assert _scene_layers(controller)["touch_depth"] is after["touch_depth"]
    controller.window.look.panes[0].dims_chosen.emit("scene")
    assert wait_until_shown(controller, LIMIT_S), controller.window.banner.text
    assert controller.window.scene_panel.isVisible()
    assert _scene_layers(controller)["touch_depth"] is not after["touch_depth"]


def test_a_card_replaces_the_scene_and_a_button_brings_it_back(bubble_window):
    window = bubble_window.window
    for active, stage in enumerate(("source", "touch_depth")):
        window.look.activate_pane(active)
        window.look.choose_stage(stage)
    assert bubble_window.session.layout.panes[1] == ("touch_depth", "both")
    assert window.columns["touch_depth"].isVisible()
    assert window.columns["touch_depth"].head.isVisible()
    assert not window.scene_panel.isVisible()
    window.look.panes[1].dims_chosen.emit("scene")
    assert bubble_window.session.layout.panes == PANES
    assert window.scene_panel.isVisible()
    assert not window.columns["touch_depth"].head.isVisible()
    assert not window.view_panels["touch_depth"].isVisible()


def test_one_pane_at_most_has_the_scene():
    moved = Layout(panes=PANES).with_dims(0, "scene")
    assert moved.panes == (("source", "scene"), ("touch_depth", "3D"), ("touch", "both"))
    twice = Layout(panes=(("source", "scene"), ("touch", "scene")))
    assert twice.resolve_panes(("source", "touch")) == (("source", "scene"), ("touch", "3D"))
