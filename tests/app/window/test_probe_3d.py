"""The pixel under the pointer is traced from 3D too, and a click there pins it."""

from __future__ import annotations

import numpy as np
import pytest
from PyQt6.QtCore import QPoint, Qt

from app.session.sample import SAMPLE_RECORDING
from app.shell.tour import wait_until_shown

LIMIT_S = 240


@pytest.fixture
def window(open_window):
    controller = open_window(
        SAMPLE_RECORDING, gl=True, source="gelslim", target="soft_bubble", frame=5
    )
    assert wait_until_shown(controller, LIMIT_S), controller.window.banner.text
    controller.window.resize(1600, 950)
    assert wait_until_shown(controller, LIMIT_S)
    controller.views.scene.draw_pending()
    return controller


@pytest.mark.parametrize("name", ["source", "depth", "target_depth", "touch_depth"])
def test_a_click_in_3d_pins_the_pixel_drawn_there(window, qtbot, name):
    columns = window.window.columns
    view = window.window.view_panels[name].view
    of = window.latest_frame.results["depth" if name == "source" else name].output
    touched = np.argwhere(of.contact)
    wanted = tuple(touched[np.abs(touched - touched.mean(axis=0)).sum(axis=1).argmin()])
    window.probe.probe_pixel(name, *(int(v) for v in wanted))
    window.probe.draw_pending()
    dot = view.marker
    assert dot is not None
    window.probe.clear_trace()
    qtbot.mouseClick(view, Qt.MouseButton.LeftButton, pos=dot.toPoint())
    found = columns[name].view.canvas.crosshair
    assert found is not None
    rows = columns[name].view.preview.pixels.shape[0]
    # a few pixels of a view this small
    assert np.abs(np.subtract(found, wanted)).max() < 0.06 * rows
    assert window.window.actions_by_name["pin_probe"].isChecked()


def test_a_rotation_is_no_click_and_empty_space_traces_nothing(window, qtbot):
    view = window.window.view_panels["depth"].view
    qtbot.mouseClick(view, Qt.MouseButton.LeftButton, pos=QPoint(1, 1))
    assert window.window.columns["depth"].view.canvas.crosshair is None
    qtbot.mousePress(view, Qt.MouseButton.LeftButton, pos=QPoint(80, 60))
    qtbot.mouseMove(view, QPoint(110, 70))
    qtbot.mouseRelease(view, Qt.MouseButton.LeftButton, pos=QPoint(110, 70))
    assert window.window.columns["depth"].view.canvas.crosshair is None
