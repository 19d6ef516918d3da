"""Pictures show what they are given and say what a pixel reads."""

from __future__ import annotations

import numpy as np
import pytest
from PyQt6.QtCore import QPoint, QPointF, Qt
from PyQt6.QtGui import QWheelEvent
from PyQt6.QtWidgets import QLabel

from pipeline.sensors.spec import load_sensor
from pipeline.views.colours import NO_VALUE_COLOUR, ColourScale, apply_colour_map, get_colour_table
from pipeline.views.preview import PixelPositions, Preview
from widgets.stages.stage_column import StageColumn
from widgets.views.preview_view import PreviewView

SCALE = ColourScale(
    colour_map="viridis", low=0.0, high=2.0, unit="mm", quantity="indentation, + toward camera"
)


def a_picture(rows: int = 30, cols: int = 40) -> Preview:
    values = np.linspace(0, 2, rows * cols, dtype=np.float32).reshape(rows, cols)
    values[0, 0] = np.nan
    places = np.zeros((rows, cols, 3), dtype=np.float32)
    places[5, 7] = (1.0, 2.0, 3.0)
    outline = np.array([[1, 1], [5, 1], [5, 5], [np.nan, np.nan]], dtype=np.float32)
    return Preview(
        pixels=apply_colour_map(values, SCALE),
        values=values,
        scale=SCALE,
        frame_name="digit frame",
        positions_mm=places,
        outline_px=outline,
        pixel_mm=0.5,
        caption="indentation",
    )


@pytest.fixture
def view(qtbot):
    made = PreviewView()
    qtbot.addWidget(made)
    made.resize(300, 300)
    made.show()
    qtbot.waitExposed(made)
    return made


def test_colours_run_from_low_to_high_under_fixed_limits():
    values = np.array([-1.0, 0.0, 2.0, 9.0, np.nan], dtype=np.float32)
    colours = apply_colour_map(values, SCALE)
    assert (colours[0] == get_colour_table("viridis")[0]).all()
    assert (colours[1] == get_colour_table("viridis")[0]).all()
    assert (colours[2] == get_colour_table("viridis")[255]).all()
    assert (colours[3] == get_colour_table("viridis")[255]).all()
    assert tuple(colours[4]) == NO_VALUE_COLOUR


def test_a_pixel_reads_value_unit_and_place():
    text = a_picture().describe_pixel(5, 7)
    assert "indentation" in text
    assert "mm" in text
    assert text.startswith("(7, 5)")
    assert "x 1.00, y 2.00, z 3.00 mm in digit frame" in text


def test_a_pixel_without_a_value_says_so():
    assert "none" in a_picture().describe_pixel(0, 0)


def test_a_pixel_outside_reads_nothing():
    assert a_picture().describe_pixel(99, 0) == ""


def test_the_pixel_under_the_mouse_is_the_pixel_that_is_drawn_there(view, qtbot):
    view.show_preview(a_picture())
    qtbot.wait(30)
    place = view.canvas.to_screen(QPointF(7.5, 5.5))
    with qtbot.waitSignal(view.pixel_hovered) as signal:
        qtbot.mouseMove(view.canvas, place.toPoint())
    assert signal.args == [5, 7]


def test_another_size_of_picture_is_fitted_and_the_same_size_keeps_the_zoom(view):
    view.show_preview(a_picture())
    view.fit_to_box((0.0, 0.0, 10.0, 10.0))
    zoomed = view.canvas.centre, view.canvas.scale
    view.show_preview(a_picture())
    assert (view.canvas.centre, view.canvas.scale) == zoomed
    view.show_preview(a_picture(60, 80))
    assert view.canvas.is_fitted


def test_a_crosshair_that_moves_draws_no_picture_anew(view, qtbot):
    view.show_preview(a_picture())
    qtbot.wait(50)
    view.canvas.repaint()
    before = view.canvas.n_renders
    for row in range(5):
        view.canvas.show_crosshair((row, row), f"{row} mm")
        view.canvas.repaint()
    assert view.canvas.n_renders == before
    view.canvas.invalidate()
    view.canvas.repaint()
    assert view.canvas.n_renders == before + 1


def test_the_wheel_zooms_about_the_pixel_under_it(view):
    view.show_preview(a_picture())
    at = QPointF(90.0, 120.0)
    under = view.canvas.to_image(at)
    keys = Qt.KeyboardModifier.NoModifier
    buttons = Qt.MouseButton.NoButton
    turned = QWheelEvent(
        at, at, QPoint(), QPoint(0, 240), buttons, keys, Qt.ScrollPhase.NoScrollPhase, False
    )
    before = view.canvas.scale
    view.canvas.wheelEvent(turned)
    assert view.canvas.scale > 1.5 * before
    still = view.canvas.to_image(at) - under
    assert abs(still.x()) + abs(still.y()) < 1e-6


def test_zooming_out_stops_at_the_whole_image(view):
    view.show_preview(a_picture())
    whole = view.canvas.scale
    at = QPointF(20.0, 30.0)
    keys = Qt.KeyboardModifier.NoModifier
    buttons = Qt.MouseButton.NoButton
    for turn in (240, -120, -1200):
        view.canvas.wheelEvent(
            QWheelEvent(
                at,
                at,
                QPoint(),
                QPoint(0, turn),
                buttons,
                keys,
                Qt.ScrollPhase.NoScrollPhase,
                False,
            )
        )
    assert view.canvas.scale == whole


def test_a_contact_is_fitted_by_its_outline(view):
    view.show_preview(a_picture())
    box = view.find_contact_box_px()
    assert box == (1.0, 1.0, 5.0, 5.0)
    view.fit_to_box(box)
    assert view.canvas.centre == QPointF(3.0, 3.0)
    corner = view.canvas.to_screen(QPointF(5.0, 5.0))
    assert 0.6 * view.canvas.width() < corner.x() < view.canvas.width()


def test_a_stale_column_keeps_its_picture_as_it_is_under_a_line_in_its_head(qtbot):
    column = StageColumn("depth", "Depth")
    qtbot.addWidget(column)
    column.resize(300, 300)
    column.view.show_preview(a_picture())
    column.show_state("computed", 12.0)
    before = column.view.canvas.grab().toImage()
    column.show_state("stale")
    assert column._line.autoFillBackground()
    assert column.view.message.text() == ""
    assert column.view.canvas.grab().toImage() == before
    column.show_state("computed", 12.0)
    assert not column._line.autoFillBackground()


def test_a_skipped_column_shows_its_first_note(qtbot):
    column = StageColumn("pose", "Pose")
    qtbot.addWidget(column)
    column.show_state("skipped", 0.1, ("no mesh", "more"))
    assert column.view.message.text() == "no mesh"


def test_a_column_shows_its_badge_beside_the_image_and_all_it_knows_as_a_tooltip(qtbot):
    column = StageColumn("depth", "Depth")
    qtbot.addWidget(column)
    column.show()
    column.show_state("computed", 12.0, ("sensor not calibrated: press a ball", "more"), "a badge")
    label = column.findChild(QLabel, "note_depth")
    assert label.text() == "a badge"
    assert "press a ball" in label.toolTip()
    assert "12 ms" in label.toolTip()
    column.show_state("computed", 12.0)
    assert label.isHidden()


def test_places_along_the_rays_of_a_camera_are_those_of_all_of_them():
    camera = load_sensor("digit").camera.scale(0.1)
    depth = np.linspace(10, 20, camera.rows * camera.cols, dtype=np.float32).reshape(camera.shape)
    depth[2, 3] = np.nan
    pixels = np.zeros((*camera.shape, 3), np.uint8)
    picture = Preview(
        pixels=pixels, frame_name="digit frame", positions_mm=PixelPositions(camera, depth)
    )
    whole = picture.compute_positions_mm()
    np.testing.assert_allclose(picture.positions_mm.compute_point_mm(5, 7), whole[5, 7], rtol=1e-6)
    x, y, z = whole[5, 7]
    assert picture.describe_pixel(5, 7).endswith(
        f"x {x:.2f}, y {y:.2f}, z {z:.2f} mm in digit frame"
    )
    assert "mm in" not in picture.describe_pixel(2, 3)
