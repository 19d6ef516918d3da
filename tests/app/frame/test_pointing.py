"""The pixel under the pointer is traced from 3D too, and a click there pins it."""

from __future__ import annotations

import numpy as np
import pytest
from PyQt6.QtCore import QPoint, Qt

from app.frame.tour import wait_until_shown
from app.session.sample import SAMPLE

LIMIT_S = 60


@pytest.fixture
def window(open_window):
    instrument = open_window(SAMPLE, gl=True, source="gelslim", target="soft_bubble", frame=5)
    assert wait_until_shown(instrument, LIMIT_S), instrument.window.banner.text
    instrument.window.resize(1600, 950)
    assert wait_until_shown(instrument, LIMIT_S)
    instrument.screen.scene.settle()
    return instrument


@pytest.mark.parametrize("name", ["source", "depth", "view", "felt"])
def test_a_click_in_3d_pins_the_pixel_whose_dot_is_drawn_there(window, qtbot, name):
    columns, view = window.window.columns, window.window.cells[name].view
    outline = columns["depth" if name == "source" else name].view.picture.outline_px
    middle = np.nanmean(outline, axis=0)
    wanted = (int(middle[1]), int(middle[0]))
    if columns[name].view.picture.positions_mm is not None:
        known = np.argwhere(np.isfinite(columns[name].view.picture.positions_mm[..., 2]))
        wanted = tuple(known[np.abs(known - wanted).sum(axis=1).argmin()])
    window.tracer.hover(name, *(int(v) for v in wanted))
    window.tracer.settle()
    dot = view.dot
    if dot is None:
        pytest.skip("nothing is traced from there to this view")
    window.tracer.clear()
    at = QPoint(round(dot.x() * view.width()), round(dot.y() * view.height()))
    qtbot.mouseClick(view, Qt.MouseButton.LeftButton, pos=at)
    found = columns[name].view.cross
    assert found is not None
    rows = columns[name].view.picture.pixels.shape[0]
    assert np.abs(np.subtract(found, wanted)).max() < 0.06 * rows  # a few pixels of a view this small
    assert window.window.actions_by_name["freeze_trace"].isChecked()


def test_a_turn_is_no_click_and_empty_space_traces_nothing(window, qtbot):
    view = window.window.cells["depth"].view
    qtbot.mouseClick(view, Qt.MouseButton.LeftButton, pos=QPoint(1, 1))
    assert window.window.columns["depth"].view.cross is None
    qtbot.mousePress(view, Qt.MouseButton.LeftButton, pos=QPoint(80, 60))
    qtbot.mouseMove(view, QPoint(110, 70))
    qtbot.mouseRelease(view, Qt.MouseButton.LeftButton, pos=QPoint(110, 70))
    assert window.window.columns["depth"].view.cross is None
