"""A folder of recordings as one table: what it says, and that Enter opens a recording."""

from __future__ import annotations

import shutil
from contextlib import closing

import cv2
import numpy as np
import pytest
from PyQt6.QtCore import Qt

from app.session.sample import SAMPLE_RECORDING
from app.shell.tour import wait_until_shown
from pipeline.io import open_recording
from pipeline.translation.reports import folder_overview
from widgets.folder.folder_page import CONTACT, FRAMES, NAME, WARNINGS

LIMIT_MS = 240_000
NAMES = ("first_touch", "grasps_cross", "no_contact")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    folder = tmp_path / "recordings"
    folder.mkdir()
    for name in NAMES:
        shutil.copy(SAMPLE_RECORDING.with_name(f"{name}.h5"), folder)
    (folder / "damaged.h5").write_bytes(SAMPLE_RECORDING.read_bytes()[:4000])
    return folder


def wait_for_rows(page, qtbot):
    qtbot.waitUntil(lambda: len(page.rows) == len(page.paths) > 0, timeout=LIMIT_MS)


def test_every_recording_is_a_row_and_enter_opens_it(open_window, folder, qtbot):
    controller = open_window(folder)
    window = controller.window
    page = window.folder
    wait_for_rows(page, qtbot)
    assert window.pages.currentWidget() is page
    model = page.model
    cells = {
        path.stem: [model.item(row, column).text() for column in range(model.columnCount())]
        for row, path in enumerate(page.paths)
    }
    assert set(cells) == {*NAMES, "damaged"}
    for name in NAMES:
        with closing(open_recording(folder / f"{name}.h5")) as recording:
            assert cells[name][FRAMES] == str(recording.streams[0].n_frames)
    assert [cells[name][CONTACT] for name in NAMES] == ["69%", "100%", "0%"]
    assert cells["damaged"][WARNINGS]
    assert cells["damaged"][FRAMES] == ""

    page.table.filter_line.setText("touched cross")
    assert page.table.model().rowCount() == 1
    page.table.filter_line.setText("unreadable")
    assert page.table.model().index(0, NAME).data() == "damaged.h5"
    page.table.filter_line.clear()
    page.table.sortByColumn(CONTACT, Qt.SortOrder.DescendingOrder)
    assert page.table.model().index(0, NAME).data() == "grasps_cross.h5"

    page.table.setCurrentIndex(page.table.model().index(0, NAME))
    page.table.setFocus()
    qtbot.keyClick(page.table, Qt.Key.Key_Return)
    assert wait_until_shown(controller, 240), window.banner.text
    assert controller.session.recording == folder / "grasps_cross.h5"
    assert controller.session.layout.name == "look"
    assert window.layout_tabs.isTabVisible(window.layout_tabs.count() - 1), "the way back"


def test_the_second_time_nothing_is_read(open_window, folder, qtbot, monkeypatch):
    page = open_window(folder).window.folder
    wait_for_rows(page, qtbot)
    rows = dict(page.rows)
    monkeypatch.setattr(folder_overview, "inspect_recording", None)
    again = open_window(folder).window.folder
    wait_for_rows(again, qtbot)
    for path, row in again.rows.items():
        assert (row.sensors, row.n_frames, row.first_touch, row.warnings) == (
            rows[path].sensors,
            rows[path].n_frames,
            rows[path].first_touch,
            rows[path].warnings,
        )
        assert (row.thumbnail == rows[path].thumbnail).all()


@pytest.mark.ranks_frames
def test_the_worst_frame_is_the_one_with_the_largest_error(open_window, folder, qtbot):
    for name in ("damaged", "no_contact", "first_touch"):
        (folder / f"{name}.h5").unlink()
    shutil.copy(folder / "grasps_cross.h5", folder / "same.h5")
    controller = open_window(folder)
    page = controller.window.folder
    wait_for_rows(page, qtbot)
    page.run_bar.start_button.click()
    qtbot.waitUntil(lambda: len(page.worst) == 2, timeout=LIMIT_MS)
    worst = page.worst[folder / "same.h5"]
    page.recording_chosen.emit(folder / "same.h5")
    assert wait_until_shown(controller, 240)
    strip = controller.window.timeline.errors
    qtbot.waitUntil(
        lambda: len(strip.values) == 3 and all(v == v for v in strip.values), timeout=LIMIT_MS
    )
    assert worst.frame == strip.worst_frame
    assert worst.error_mm == pytest.approx(strip.max_value)


def test_a_folder_of_images_is_one_recording(tmp_path):
    for name in ("0", "1"):
        cv2.imwrite(str(tmp_path / f"{name}.png"), np.zeros((4, 4, 3), np.uint8))
    assert folder_overview.list_recordings(tmp_path) == ()
    assert folder_overview.list_recordings(SAMPLE_RECORDING) == ()
