"""3D layers are written in place, and only drawn when Qt paints."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from PyQt6.QtCore import QPoint, Qt
from PyQt6.QtWidgets import QApplication

from pipeline.views.colours import ColourScale, get_colour_table, repeat_colour
from pipeline.views.layers import Layer, ViewBounds
from widgets.style.theme import is_dark, use_palette
from widgets.views.scene_renderer import SceneRenderer
from widgets.views.view_3d import View3D

pytestmark = pytest.mark.gl


def points(n: int, name: str = "cloud", z: float = 10.0) -> Layer:
    xyz = np.random.default_rng(n).normal(size=(n, 3)).astype(np.float32)
    xyz[:, 2] += z
    return Layer(name=name, points_mm=xyz, rgb=repeat_colour((200, 40, 40), n))


def surface(z: float) -> Layer:
    xyz = np.array([[-1, -1, z], [1, -1, z], [-1, 1, z], [1, 1, z]], dtype=np.float32)
    triangles = np.array([[0, 2, 1], [1, 2, 3]], dtype=np.int32)
    normals = np.tile(np.array([0, 0, -1], dtype=np.float32), (4, 1))
    return Layer(
        name="sheet",
        points_mm=xyz,
        rgb=repeat_colour((40, 160, 60), 4),
        triangles=triangles,
        normals=normals,
    )


SIGNED = ColourScale(colour_map="diverging", low=-1.0, high=1.0, unit="mm", quantity="deviation")
SIGHTS = {
    0: ViewBounds(centre_mm=(0, 0, 10), radius_mm=2.0, frame="a"),
    1: ViewBounds(centre_mm=(0, 0, 10), radius_mm=2.0, frame="a"),
}


@pytest.fixture
def scene(qtbot):
    """Two views side by side, each 150 px wide."""
    made = [View3D(), View3D()]
    for view in made:
        qtbot.addWidget(view)
        view.resize(150, 150)
        view.show()
        qtbot.waitExposed(view)
    live = SceneRenderer(made)
    live.open()
    yield live
    live.close()


def test_nothing_is_rebuilt_while_the_count_stays(scene):
    scene.show_layers(0, [points(50)])
    scene.draw_pending()
    actors = scene.renderers[0].GetActors().GetNumberOfItems()
    scene.show_layers(0, [points(50, z=12.0)])
    scene.draw_pending()
    scene.show_layers(0, [points(70)])
    scene.draw_pending()
    assert scene.renderers[0].GetActors().GetNumberOfItems() == actors


def test_points_are_those_of_the_newest_layer(scene):
    newest = points(70, z=12.0)
    scene.show_layers(0, [points(50)])
    scene.draw_pending()
    scene.show_layers(0, [newest])
    scene.draw_pending()
    mesh = scene._stage._kept[0]["cloud"][1]
    np.testing.assert_array_equal(np.asarray(mesh.points), newest.points_mm)


def test_a_layer_that_is_no_longer_wanted_is_hidden(scene):
    scene.show_layers(0, [points(50), surface(10.0)])
    scene.draw_pending()
    scene.show_layers(0, [surface(10.0)])
    scene.draw_pending()
    assert not scene._stage._kept[0]["cloud"][2].GetVisibility()
    assert scene._stage._kept[0]["sheet"][2].GetVisibility()


def test_an_empty_layer_is_no_error(scene):
    for n in (0, 5, 0):
        scene.show_layers(0, [points(n)])
        scene.draw_pending()


def test_linked_views_share_a_camera_and_others_do_not(scene):
    scene.fit_cameras(SIGHTS, linked=True)
    assert scene.renderers[0].GetActiveCamera() is scene.renderers[1].GetActiveCamera()
    scene.fit_cameras(SIGHTS, linked=False)
    assert scene.renderers[0].GetActiveCamera() is not scene.renderers[1].GetActiveCamera()


def test_a_surface_seen_from_the_sensor_is_lit(scene, qtbot):
    scene.fit_cameras(SIGHTS, linked=True)
    scene.show_layers(0, [surface(10.0)])
    scene.draw_pending()
    image = scene.views[0].image
    middle = image.pixelColor(image.width() // 2, image.height() // 2)
    # the colour given is (40, 160, 60); an unlit back face has a third of it
    assert middle.green() > 90


def ink(scene) -> list[int]:
    """How many pixels of each view are green, as the sheet is."""
    scene.draw_pending()
    images = [view.image for view in scene.views]
    seen = [
        [i.pixelColor(x, y) for x in range(i.width()) for y in range(i.height())] for i in images
    ]
    return [sum(c.green() > c.red() + 30 for c in view) for view in seen]


@pytest.mark.parametrize("linked", [True, False])
def test_layers_that_come_after_the_cameras_were_set_anew_are_drawn_whole(scene, qtbot, linked):
    """A gel's camera looks from 20 mm, a bubble's from 100 mm: neither hides what the other
    shows.
    """
    scene.fit_cameras(SIGHTS, linked=linked)
    for column in SIGHTS:
        scene.show_layers(column, [surface(10.0)])
    whole = ink(scene)
    assert min(whole) > 500
    scene.fit_cameras(
        {i: replace(sight, centre_mm=(0, 0, 110)) for i, sight in SIGHTS.items()}, linked=linked
    )
    scene.draw_pending()
    scene.show_layers(0, [surface(110.0)])
    scene.show_layers(1, [surface(110.0)])
    assert ink(scene) == pytest.approx(whole, rel=0.05)


def test_the_mouse_turns_the_view_under_it_and_those_that_share_its_camera(scene, qtbot):
    scene.fit_cameras(SIGHTS, linked=True)
    scene.show_layers(0, [surface(10.0)])
    scene.show_layers(1, [surface(10.0)])
    before = ink(scene)
    view = scene.views[0]
    qtbot.mousePress(view, Qt.MouseButton.LeftButton, pos=QPoint(75, 75))
    qtbot.mouseMove(view, QPoint(120, 60))
    qtbot.mouseRelease(view, Qt.MouseButton.LeftButton, pos=QPoint(120, 60))
    after = ink(scene)
    assert abs(after[0] - before[0]) > 0.05 * before[0]
    assert after[1] == pytest.approx(after[0], rel=0.05)


def test_what_comes_together_is_drawn_once_and_what_has_not_changed_not_at_all(scene, qtbot):
    scene.fit_cameras(SIGHTS, linked=False)
    scene.draw_pending()
    before = scene.n_renders
    for z in (10.0, 11.0, 12.0):
        scene.show_layers(0, [surface(z)])
    qtbot.waitUntil(lambda: scene.n_renders > before, timeout=240_000)
    qtbot.wait(50)
    assert scene.n_renders == before + 1


def test_a_view_that_nobody_sees_is_not_drawn_until_it_is_shown(scene, qtbot):
    scene.fit_cameras(SIGHTS, linked=True)
    scene.draw_pending()
    scene.views[1].hide()
    before = scene.n_renders
    for z in (10.0, 11.0, 12.0):
        scene.show_layers(1, [surface(z)])
        scene.draw_pending()
        qtbot.wait(30)
    assert scene.n_renders == before
    scene.views[1].show()
    qtbot.waitUntil(lambda: scene.n_renders == before + 1, timeout=240_000)


def test_a_view_seen_before_is_not_drawn_again(scene):
    scene.fit_cameras(SIGHTS, linked=True)
    frames = [[surface(10.0)], [surface(11.0)]]
    for layers in frames:
        scene.show_layers(0, layers)
        scene.draw_pending()
    before = scene.n_renders
    newest = scene.views[0].image
    scene.show_layers(0, frames[0])
    scene.draw_pending()
    assert scene.n_renders == before
    assert scene.views[0].image is not newest
    half = np.diag([0.5, 0.5, 0.5, 1.0])
    scene.show_layers(0, [replace(frames[0][0], view_from_layer=half)])  # another picture
    scene.draw_pending()
    assert scene.n_renders == before + 1


def test_the_traced_dot_lies_where_its_point_is_drawn_and_costs_no_drawing(scene):
    scene.fit_cameras(SIGHTS, linked=True)
    scene.draw_pending()
    before = scene.n_renders
    scene.mark_point(0, (0.0, 0.0, 10.0))  # what the camera looks at
    view = scene.views[0]
    middle = 0.5 * view.width(), 0.5 * view.height()
    assert (view.marker.x(), view.marker.y()) == pytest.approx(middle, abs=1e-3)
    scene.mark_point(0, (1.0, 0.0, 10.0))
    assert view.marker.x() != pytest.approx(middle[0], abs=0.05 * view.width())
    scene.mark_point(0, (0.0, 0.0, -1000.0))
    assert view.marker is None, "behind the camera"
    scene.mark_point(0, (0.0, 0.0, 10.0))
    scene.mark_point(0, None)
    assert view.marker is None
    scene.draw_pending()
    assert scene.n_renders == before


def test_a_driver_that_fails_leaves_a_window_that_works(qtbot, monkeypatch):
    def fails(*args, **kwargs):
        raise RuntimeError("no OpenGL here")

    monkeypatch.setattr("widgets.views.offscreen_renderer.OffscreenRenderer", fails)
    view = View3D()
    qtbot.addWidget(view)
    scene = SceneRenderer([view])
    scene.show_layers(0, [points(5)])
    scene.open()
    assert not scene.is_open
    assert "no OpenGL here" in view.notice
    scene.close()


def test_a_faint_surface_does_not_shine_through_one_in_the_same_place(scene):
    scene.fit_cameras(SIGHTS, linked=True)
    sheet = surface(10.0)
    finer = np.linspace(-1, 1, 40, dtype=np.float32)
    rounding = np.random.default_rng(0).normal(scale=1e-5, size=(40, 40))
    xyz = (
        np.stack([*np.meshgrid(finer, finer), 10.0 + rounding], axis=-1)
        .reshape(-1, 3)
        .astype(np.float32)
    )
    first = (np.arange(39)[:, None] * 40 + np.arange(39)[None, :]).ravel()
    triangles = np.concatenate(
        [
            np.stack([first, first + 40, first + 1], -1),
            np.stack([first + 1, first + 40, first + 41], -1),
        ]
    ).astype(np.int32)
    faint = Layer(
        name="membrane",
        points_mm=xyz,
        rgb=repeat_colour((200, 200, 255), 1600),
        triangles=triangles,
        normals=np.tile(np.array([0, 0, -1], np.float32), (1600, 1)),
        opacity=0.22,
    )
    scene.show_layers(0, [sheet, faint])
    scene.draw_pending()
    with_it = np.array([scene.views[0].image.pixelColor(x, 75).blue() for x in range(60, 90)])
    assert with_it.std() < 2.0, "stripes of the faint one"


def test_signed_values_take_the_colours_of_the_theme(scene, qtbot):
    light = np.array(get_colour_table("diverging")[[127]])
    sheet = replace(surface(10.0), rgb=np.repeat(light, 4, axis=0), scale=SIGNED)
    true = replace(sheet, name="true", scale=None)
    before = QApplication.palette()
    scene.show_layers(0, [sheet, true])
    try:
        for dark in (False, True):
            use_palette(dark=dark)
            qtbot.waitUntil(lambda: is_dark(scene.views[0].palette()) == dark)  # noqa: B023
            scene._draw_soon(0)
            scene.draw_pending()
            expected = get_colour_table("diverging_dark" if dark else "diverging")[127]
            kept = scene._stage._kept[0]
            assert (np.asarray(kept["sheet"][1].point_data["rgb"]) == expected).all()
            assert (np.asarray(kept["true"][1].point_data["rgb"]) == light).all()
    finally:
        QApplication.setPalette(before)
