"""The map of where a registration ends, on request; a click goes to what a start ended in."""

from __future__ import annotations

import numpy as np
import pytest
from PyQt6.QtCore import Qt

from app.session.sample import SAMPLE_RECORDING
from app.window.basin_map import BasinMapController
from app.window.tour import wait_until_shown
from pipeline.stages.pose import basin_map as stage

LIMIT_S, LIMIT_MS = 60, 60_000


@pytest.fixture
def coarse(monkeypatch):
    """A few starts are enough here."""
    monkeypatch.setattr(stage, "_EVERY_DEG", 90.0)
    monkeypatch.setattr(stage, "_SHIFTS", 3)


@pytest.fixture
def window(open_window, coarse):
    instrument = open_window(SAMPLE_RECORDING, gl=True, source="gelslim", target="soft_bubble", frame=8)
    assert wait_until_shown(instrument, LIMIT_S), instrument.window.banner.text
    return instrument


def _tab(instrument):
    return next(child for child in instrument.children() if isinstance(child, BasinMapController))


def test_a_click_goes_to_what_a_start_ended_in(window, qtbot):
    tab, panel = _tab(window), window.window.basins
    window.window.actions_by_name["map_basins"].trigger()
    qtbot.waitUntil(lambda: tab.result is not None, timeout=LIMIT_MS)
    assert panel.isVisible()
    assert "12 starts" in panel.message
    of, view = tab.result.basins, window.window.columns["pose"].view
    assert [len(row) for row in panel.map.cells] == [4, 4, 4]
    own = view.picture
    row, col = next(zip(*np.nonzero(of.minimum_index > 0), strict=True))
    at = panel.map._room(int(row), int(col)).center().toPoint()
    qtbot.mouseClick(panel.map, Qt.MouseButton.LeftButton, pos=at)
    qtbot.waitUntil(lambda: view.picture is not own, timeout=LIMIT_MS)
    assert f"rms {of.rmse_mm[row, col]:.2f} mm" in view.picture.caption
    placed = window.views.scene._placed[list(window.window.columns).index("pose")]["object"]
    assert placed == pytest.approx(of.poses[row, col])
    window.choose_frame(5)  # what was found is of another frame
    assert tab.result is None
    assert panel.map.cells == ()
    assert wait_until_shown(window, LIMIT_S)


def test_it_can_be_stopped_and_says_why_there_is_nothing_to_map(window, qtbot, monkeypatch):
    tab, panel = _tab(window), window.window.basins
    window.window.actions_by_name["map_basins"].trigger()
    assert panel.go.text() == "Cancel"
    panel.go.click()
    qtbot.waitUntil(lambda: panel.go.text() == "Map basins", timeout=LIMIT_MS)
    assert panel.message == "stopped" or tab.result is not None
    window.choose_frame(0)
    assert wait_until_shown(window, LIMIT_S)
    panel.go.click()
    qtbot.waitUntil(lambda: "no pose to look around" in panel.message, timeout=LIMIT_MS)
