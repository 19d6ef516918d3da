"""The scene of both sensors in a pane of the window."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from PyQt6.QtCore import QPoint, Qt

from app.session.layout import Layout
from app.session.sample import SAMPLE_RECORDING
from app.shell.tour import wait_until_shown
from app.stages.scene import SceneController
from pipeline.core.geometry import rigid
from pipeline.sensors.alignment import Offsets

LIMIT_S = 240
PANES = (("source", "both"), ("touch_depth", "scene"), ("touch", "both"))


def _count_colours(image) -> int:
    across, down = range(0, image.width(), 3), range(0, image.height(), 3)
    return len({image.pixelColor(x, y).rgb() for x in across for y in down})


def _scene_layers(controller) -> dict:
    place = controller.views.places["scene"]
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


def test_another_recording_leaves_nothing_of_the_one_before_in_the_scene(open_window, tmp_path):
    controller = open_window(SAMPLE_RECORDING, source="gelslim", target="soft_bubble", frame=5)
    assert wait_until_shown(controller, LIMIT_S), controller.window.banner.text
    assert {"source", "touch_depth", "object"} <= set(_scene_layers(controller))
    for k in range(2):  # touches without a reference, which no stage after the source can read
        shape = (320, 427, 3)
        image = np.random.default_rng(k).integers(60, 180, shape, dtype=np.uint8)
        cv2.imwrite(str(tmp_path / f"touch_{k}.png"), image)
    controller.open_path(tmp_path)
    assert _scene_layers(controller) == {}
    assert not wait_until_shown(controller, LIMIT_S)
    assert "No reference image" in controller.window.banner.text
    left = set(_scene_layers(controller))
    assert "source" in left
    assert not left & {"touch_depth", "recorded", "object"}


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


def _indentation_mm(controller) -> float:
    """How deep the bubble, which is the source, is in the scene."""
    points = _scene_layers(controller)["source membrane"].points_mm
    x, y, z = points.astype(float).T
    return float((controller.views.translation.source.membrane.depth_at(x, y) - z).max())


def test_space_plays_and_pauses_the_press_in_the_scene_and_esc_ends_it(bubble_window, qtbot):
    controller, view = bubble_window, bubble_window.window.scene_panel.view
    moving = controller.findChild(SceneController)
    deepest = _indentation_mm(controller)
    assert deepest > 1.0
    frame = controller.session.frame
    qtbot.keyClick(view, Qt.Key.Key_Space)
    qtbot.waitUntil(lambda: _indentation_mm(controller) < 0.01 * deepest, timeout=LIMIT_S * 1000)
    caption = controller.window.scene_panel.caption.toolTip()
    assert caption.endswith("of this frame's depth")
    assert "rays" in _scene_layers(controller)
    qtbot.keyClick(view, Qt.Key.Key_Space)
    assert moving.is_moving
    assert not controller.window.actions_by_name["press_motion"].isChecked()
    at = moving._time
    qtbot.wait(150)
    assert moving._time == at, "paused"
    assert controller.session.frame == frame, "the recording does not play"
    qtbot.keyClick(view, Qt.Key.Key_Space)
    qtbot.waitUntil(lambda: moving._time != at, timeout=LIMIT_S * 1000)
    qtbot.keyClick(view, Qt.Key.Key_Escape)
    assert not moving.is_moving
    assert _indentation_mm(controller) == deepest
    assert "rays" not in _scene_layers(controller)


@pytest.mark.gl
def test_views_zoom_and_measure_of_the_scene(open_window, qtbot):
    controller = open_window(
        SAMPLE_RECORDING, gl=True, source="gelslim", target="soft_bubble", frame=5
    )
    assert wait_until_shown(controller, LIMIT_S), controller.window.banner.text
    scene, view = controller.views.scene, controller.window.scene_panel.view
    actions = controller.window.actions_by_name
    qtbot.waitUntil(lambda: scene.is_open, timeout=LIMIT_S * 1000)
    place = controller.views.places["scene"]
    actions["scene_source"].trigger()
    scene.draw_pending()
    labels = view.labels
    # along the optical axis: what is on it is one point
    assert abs(labels["S"].x() - labels["A"].x()) < 0.01 * view.width()
    assert abs(labels["S"].y() - labels["A"].y()) < 0.01 * view.height()
    actions["scene_side"].trigger()
    scene.draw_pending()
    before = _count_colours(view.image)
    bar = view.scale_bar
    actions["scene_orthographic"].trigger()
    scene.draw_pending()
    assert view.scale_bar[1] == bar[1]
    assert view.scale_bar[0] == pytest.approx(bar[0], rel=1e-3), "as large as before"
    fitted_mm = scene._stage.measure_view_mm(place)
    camera = scene._stage.renderers[place].GetActiveCamera()
    for factor, limit in ((1.3, 0.02), (1 / 1.3, 4.0)):  # in, then out, far beyond use
        for _ in range(60):
            camera.Dolly(factor)
            scene._stage.limit_camera(place)
        assert scene._stage.measure_view_mm(place) == pytest.approx(limit * fitted_mm, rel=1e-3)
    scene._draw_soon(place)
    scene.draw_pending()
    assert _count_colours(view.image) > 3, "still in sight"
    camera.SetFocalPoint(900.0, 0.0, 0.0)
    scene._stage.limit_camera(place)
    away = np.subtract(camera.GetFocalPoint(), controller.views._page_bounds["scene"].centre_mm)
    assert np.linalg.norm(away) == pytest.approx(controller.views._page_bounds["scene"].radius_mm)
    actions["scene_orthographic"].trigger()
    controller.views.reset_cameras(controller.session)
    actions["scene_source"].trigger()
    scene.draw_pending()
    assert before > 100
    actions["scene_measure"].trigger()
    corners = _scene_layers(controller)["source"]
    drawn = rigid.apply(corners.view_from_layer, corners.points_mm[[0, -1]])
    for x_px, y_px in scene.project_points(place, drawn):
        qtbot.mouseClick(view, Qt.MouseButton.LeftButton, pos=QPoint(round(x_px), round(y_px)))
    (text,) = set(view.labels) - {"S", "A", "T"}
    length = float(np.linalg.norm(drawn[1] - drawn[0]))
    assert float(text.removesuffix(" mm")) == pytest.approx(length, rel=0.05)
    actions["scene_measure"].trigger()
    assert set(view.labels) == {"S", "A", "T"}
