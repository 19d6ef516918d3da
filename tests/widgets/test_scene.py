"""3D layers are written in place, and only drawn when Qt paints."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from PyQt6.QtCore import QPoint, Qt

from pipeline.pictures.colours import uniform
from pipeline.pictures.layers import Layer, Sight
from widgets.layers import Scene
from widgets.scene import LiveScene, best_scene

pytestmark = pytest.mark.gl


def points(n: int, name: str = "cloud", z: float = 10.0) -> Layer:
    xyz = np.random.default_rng(n).normal(size=(n, 3)).astype(np.float32)
    xyz[:, 2] += z
    return Layer(name=name, points_mm=xyz, rgb=uniform((200, 40, 40), n))


def surface(z: float) -> Layer:
    xyz = np.array([[-1, -1, z], [1, -1, z], [-1, 1, z], [1, 1, z]], dtype=np.float32)
    triangles = np.array([[0, 2, 1], [1, 2, 3]], dtype=np.int32)
    normals = np.tile(np.array([0, 0, -1], dtype=np.float32), (4, 1))
    return Layer(name="sheet", points_mm=xyz, rgb=uniform((40, 160, 60), 4), triangles=triangles, normals=normals)


SIGHTS = {
    0: Sight(centre_mm=(0, 0, 10), radius_mm=2.0, frame="a"),
    1: Sight(centre_mm=(0, 0, 10), radius_mm=2.0, frame="a"),
}


@pytest.fixture
def scene(qtbot):
    made = LiveScene(2)
    made.resize(300, 150)
    qtbot.addWidget(made)
    made.show()
    qtbot.waitExposed(made)
    yield made
    made.finish()


def test_nothing_is_rebuilt_while_the_count_stays(scene):
    scene.show_layers(0, [points(50)])
    actors = scene.renderers[0].GetActors().GetNumberOfItems()
    scene.show_layers(0, [points(50, z=12.0)])
    scene.show_layers(0, [points(70)])
    assert scene.renderers[0].GetActors().GetNumberOfItems() == actors


def test_points_are_those_of_the_newest_layer(scene):
    newest = points(70, z=12.0)
    scene.show_layers(0, [points(50)])
    scene.show_layers(0, [newest])
    mesh = scene._stage._kept[0]["cloud"][1]
    np.testing.assert_array_equal(np.asarray(mesh.points), newest.points_mm)


def test_a_layer_that_is_no_longer_wanted_is_hidden(scene):
    scene.show_layers(0, [points(50), surface(10.0)])
    scene.show_layers(0, [surface(10.0)])
    assert not scene._stage._kept[0]["cloud"][2].GetVisibility()
    assert scene._stage._kept[0]["sheet"][2].GetVisibility()


def test_an_empty_layer_is_no_error(scene):
    scene.show_layers(0, [points(0)])
    scene.show_layers(0, [points(5)])
    scene.show_layers(0, [points(0)])


def test_linked_views_share_a_camera_and_others_do_not(scene):
    scene.look(SIGHTS, linked=True)
    assert scene.renderers[0].GetActiveCamera() is scene.renderers[1].GetActiveCamera()
    scene.look(SIGHTS, linked=False)
    assert scene.renderers[0].GetActiveCamera() is not scene.renderers[1].GetActiveCamera()


def test_a_surface_seen_from_the_sensor_is_lit(scene, qtbot):
    scene.look(SIGHTS, linked=True)
    scene.show_layers(0, [surface(10.0)])
    scene.update()
    qtbot.wait(100)
    image = scene.grab().toImage()
    middle = image.pixelColor(image.width() // 4, image.height() // 2)
    assert middle.green() > 90  # the colour given is (40, 160, 60); an unlit back face has a third of it


def ink(scene, qtbot) -> list[int]:
    """How many pixels of each sub-view are green, as the sheet is."""
    scene.settle()
    qtbot.wait(100)
    image = scene.grab().toImage()
    half = image.width() // 2
    seen = [
        [image.pixelColor(x, y) for x in range(start, start + half) for y in range(image.height())]
        for start in (0, half)
    ]
    return [sum(c.green() > c.red() + 30 for c in view) for view in seen]


@pytest.mark.parametrize("linked", [True, False])
def test_layers_that_come_after_the_cameras_were_set_anew_are_drawn_whole(scene, qtbot, linked):
    """A gel's camera looks from 20 mm, a bubble's from 100 mm: neither hides what the other shows."""
    scene.look(SIGHTS, linked=linked)
    for column in SIGHTS:
        scene.show_layers(column, [surface(10.0)])
    whole = ink(scene, qtbot)
    assert min(whole) > 500
    scene.look({i: replace(sight, centre_mm=(0, 0, 110)) for i, sight in SIGHTS.items()}, linked=linked)
    scene.settle()
    qtbot.wait(50)
    scene.show_layers(0, [surface(110.0)])
    scene.show_layers(1, [surface(110.0)])
    assert ink(scene, qtbot) == pytest.approx(whole, rel=0.05)


def test_the_mouse_turns_the_view_under_it_and_those_that_share_its_camera(scene, qtbot):
    scene.look(SIGHTS, linked=True)
    scene.show_layers(0, [surface(10.0)])
    scene.show_layers(1, [surface(10.0)])
    before = ink(scene, qtbot)
    qtbot.mousePress(scene, Qt.MouseButton.LeftButton, pos=QPoint(75, 75))
    qtbot.mouseMove(scene, QPoint(120, 60))
    qtbot.mouseRelease(scene, Qt.MouseButton.LeftButton, pos=QPoint(120, 60))
    after = ink(scene, qtbot)
    assert abs(after[0] - before[0]) > 0.05 * before[0]
    assert after[1] == pytest.approx(after[0], rel=0.05)


def test_what_comes_together_is_drawn_once(scene, qtbot, monkeypatch):
    drawn = []
    pixels = scene._stage.pixels
    qtbot.wait(100)
    monkeypatch.setattr(scene._stage, "pixels", lambda *size: (drawn.append(size), pixels(*size))[1])
    scene.look(SIGHTS, linked=True)
    for z in (10.0, 11.0, 12.0):
        scene.show_layers(0, [surface(z)])
    qtbot.wait(200)
    assert len(drawn) == 1


def test_a_driver_that_fails_leaves_a_window_that_works(qtbot, monkeypatch):
    def fails(*args, **kwargs):
        raise RuntimeError("no OpenGL here")

    monkeypatch.setattr("widgets.scene.LiveScene", fails)
    scene = best_scene(2)
    qtbot.addWidget(scene)
    assert type(scene) is Scene
    assert "no OpenGL here" in scene.text()
    scene.finish()
