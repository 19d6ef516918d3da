"""The map of where a registration ends, on request; a click goes to what a start ended in."""

from __future__ import annotations

import numpy as np
import pytest
from PyQt6.QtCore import Qt

from app.session.sample import SAMPLE_RECORDING
from app.window.basin_map import BasinMapController
from app.window.tour import wait_until_shown
from pipeline.stages.pose import basin_map as stage

LIMIT_S, LIMIT_MS = 240, 240_000


@pytest.fixture
def coarse(monkeypatch):
    """A few starts are enough here."""
    monkeypatch.setattr(stage, "_ROTATION_STEP_DEG", 90.0)
    monkeypatch.setattr(stage, "_N_TRANSLATIONS", 3)


@pytest.fixture
def window(open_window, coarse):
    controller = open_window(SAMPLE_RECORDING, gl=True, source="gelslim", target="soft_bubble", frame=8)
    assert wait_until_shown(controller, LIMIT_S), controller.window.banner.text
    return controller


def _tab(controller):
    return next(child for child in controller.children() if isinstance(child, BasinMapController))


def test_a_click_shows_the_pose_that_a_start_converged_to(window, qtbot):
    tab, panel = _tab(window), window.window.basins
    window.window.actions_by_name["map_basins"].trigger()
    qtbot.waitUntil(lambda: tab.result is not None, timeout=LIMIT_MS)
    assert panel.isVisible()
    assert "12 starts" in panel.message.text()
    of, view = tab.result.basins, window.window.columns["pose"].view
    assert len(panel.map.cells) == 12
    assert (len(panel.map.rows), len(panel.map.columns)) == (3, 4)
    own = view.preview
    row, col = next(zip(*np.nonzero(of.minimum_index > 0), strict=True))
    at = panel.map.get_room(int(row), int(col)).center().toPoint()
    qtbot.mouseClick(panel.map, Qt.MouseButton.LeftButton, pos=at)
    qtbot.waitUntil(lambda: view.preview is not own, timeout=LIMIT_MS)
    assert f"rms {of.rmse_mm[row, col]:.2f} mm" in view.preview.caption
    placed = window.views.scene._placed[list(window.window.columns).index("pose")]["object"]
    assert placed == pytest.approx(of.poses[row, col])
    window.choose_frame(5)  # what was found is of another frame
    assert tab.result is None
    assert panel.map.cells == {}
    assert wait_until_shown(window, LIMIT_S)


def test_the_map_can_be_cancelled_and_states_why_there_is_none(window, qtbot, monkeypatch):
    tab, panel = _tab(window), window.window.basins
    window.window.actions_by_name["map_basins"].trigger()
    assert panel.run_bar.cancel_button.isVisible()
    panel.run_bar.cancel_button.click()
    qtbot.waitUntil(panel.run_bar.start_button.isVisible, timeout=LIMIT_MS)
    assert panel.message.text() == "cancelled" or tab.result is not None
    window.choose_frame(0)
    assert wait_until_shown(window, LIMIT_S)
    panel.run_bar.start_button.click()
    qtbot.waitUntil(lambda: "no pose to map" in panel.message.text(), timeout=LIMIT_MS)
