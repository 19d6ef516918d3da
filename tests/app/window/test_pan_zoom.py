"""Pictures fitted to the contact, moved together in millimetres, and read at one place with the
truth at the end.
"""

from __future__ import annotations

import numpy as np
import pytest
from PyQt6.QtCore import QPointF

from app.session.sample import SAMPLE_RECORDING
from app.shell.tour import wait_until_shown

LIMIT_S = 240


@pytest.fixture
def window(open_window):
    controller = open_window(SAMPLE_RECORDING, source="gelslim", target="soft_bubble", frame=5)
    assert wait_until_shown(controller, LIMIT_S), controller.window.banner.text
    return controller


def _canvas(controller, name):
    return controller.window.columns[name].view.canvas


def test_one_key_fits_the_contact_and_the_sensor(window):
    action = window.window.actions_by_name["fit_contact"]
    whole = {name: _canvas(window, name).scale for name in window.window.columns}
    action.trigger()
    for name in ("cloud", "target_depth", "touch", "touch_depth"):  # the gel is full of it already
        assert _canvas(window, name).scale > 1.5 * whole[name], name
    assert (
        _canvas(window, "source").centre - _canvas(window, "depth").centre
    ).manhattanLength() < 1.0
    action.trigger()
    assert {name: _canvas(window, name).scale for name in window.window.columns} == whole


def test_linked_images_show_the_same_place_at_the_same_scale(window):
    window.window.actions_by_name["link_previews"].trigger()
    depth, view = (window.window.columns[name].view for name in ("depth", "target_depth"))
    made = window.latest_frame.results["target_depth"].output
    row, col = divmod(
        int(np.where(made.contact, made.indentation_mm, -1.0).argmax()), made.camera.cols
    )
    point = int(made.source_index[row, col])
    pixel = int(window.latest_frame.results["cloud"].output.source_index[point])
    at = divmod(pixel, depth.preview.pixels.shape[1])
    depth.canvas.set_view(QPointF(at[1] + 0.5, at[0] + 0.5), 2.0)
    depth.canvas.view_changed.emit()
    there = view.canvas.to_screen(QPointF(col + 0.5, row + 0.5))
    middle = QPointF(0.5 * view.canvas.width(), 0.5 * view.canvas.height())
    px_of_mm = view.canvas.scale / view.preview.pixel_mm
    assert px_of_mm == pytest.approx(depth.canvas.scale / depth.preview.pixel_mm)
    # within a millimetre of depth seen aslant
    assert (there - middle).manhattanLength() < 1.0 * px_of_mm


def test_every_stage_is_read_at_the_probe_with_the_truth_last(window):
    made = window.latest_frame.results["target_depth"].output
    row, col = divmod(int(made.indentation_mm.argmax()), made.camera.cols)
    window.probe.probe_pixel("target_depth", row, col)
    for name in ("source", "depth", "target_depth", "touch_depth"):
        canvas = _canvas(window, name)
        assert canvas.crosshair_text == window.window.columns[name].view.preview.format_value(
            *canvas.crosshair
        ), name
    true = window.views.translation.read_ground_truth(5).target_truth.indentation_mm
    at = _canvas(window, "touch_depth").crosshair
    assert window.window.trace.text.rpartition(" → ")[2].startswith(f"{true[at]:.3f} mm")
    assert f"truth {true[row, col]:.3f} mm" in window.window.readout.text()


def test_the_truth_is_shown_where_no_source_pixel_maps(window):
    true = window.views.translation.read_ground_truth(5).target_truth
    made = window.latest_frame.results["target_depth"].output
    missed = true.contact & (made.source_index < 0)
    row, col = (int(i) for i in np.argwhere(missed)[0])
    window.probe.probe_pixel("touch_depth", row, col)
    assert window.window.trace.text.endswith(f"{true.indentation_mm[row, col]:.3f} mm")
