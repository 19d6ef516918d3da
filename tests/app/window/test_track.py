"""The *Track* layout: run, cancel, write as the command does, and open again, from both touches."""

from __future__ import annotations

import shlex

import numpy as np
import pytest
from PyQt6.QtCore import Qt

from app.export.export import ExportController
from app.shell.tour import wait_until_shown
from app.track.track import TrackController
from pipeline.cli.main import build_app, run_app
from pipeline.lab.tracking import track_recording
from pipeline.lab.tracking.track_record import read_record

LIMIT_S = 240
LIMIT_MS = 240_000


def _child(controller, kind):
    return next(child for child in controller.children() if isinstance(child, kind))


@pytest.fixture
def track_window(bubble_window):
    bubble_window.window.actions_by_name["layout_track"].trigger()
    assert wait_until_shown(bubble_window, LIMIT_S)
    return bubble_window


def _run(controller, qtbot, stage):
    track = _child(controller, TrackController)
    page = controller.window.track
    page.stage_box.setCurrentIndex(page.stage_box.findData(stage))
    qtbot.mouseClick(page.run_bar.start_button, Qt.MouseButton.LeftButton)
    qtbot.waitUntil(lambda: track.view is not None, timeout=LIMIT_MS)
    return track


@pytest.mark.parametrize(("stage", "n_tracked"), [("depth", 2), ("touch_depth", 1)])
def test_the_window_writes_what_the_command_writes_and_reads_it_again(
    track_window, qtbot, tmp_path, stage, n_tracked
):
    track = _run(track_window, qtbot, stage)
    page = track_window.window.track
    record = track.view.record
    assert record.count("tracked") == n_tracked
    assert record.count("no contact") == 3 - n_tracked
    assert page.sentence.text().startswith(f"pressed.h5: {n_tracked} of 3 frames tracked, 0 lost")
    assert [layer.name for layer in track.view.layers] == ["patch", "path"][:n_tracked]
    assert page.plot.n_steps == 3
    page.plot.step_chosen.emit(1)
    assert track_window.session.frame == 1
    assert page.plot.current_step == 1

    export = _child(track_window, ExportController)
    track.write_track(tmp_path / "window")
    qtbot.waitUntil(lambda: "written" in export.notification.text.lower(), timeout=LIMIT_MS)
    words = shlex.split(export._written[1])
    assert words[:2] == ["tactoscope", "track"]
    words[-1] = str(tmp_path / "command")
    assert run_app(build_app(), words[1:]) == 0
    names = {"track.csv", "track.json", "patch.ply"}
    assert {file.name for file in (tmp_path / "window").iterdir()} == names
    for name in names:
        assert (tmp_path / "window" / name).read_bytes() == (
            tmp_path / "command" / name
        ).read_bytes()

    track_window.open_path(tmp_path / "window")
    qtbot.waitUntil(lambda: track.view is not None, timeout=LIMIT_MS)
    assert page.sentence.text().startswith(f"window: {n_tracked} of 3 frames tracked")
    assert not track_window.window.actions_by_name["export_track"].isEnabled()
    assert np.allclose(track.view.path_mm, read_path(tmp_path), atol=1e-4, equal_nan=True)


def read_path(folder):
    from app.track.track_jobs import make_view

    return make_view(read_record(folder / "command")).path_mm


def test_a_run_is_cancelled_and_another_recording_drops_the_track(
    track_window, qtbot, touch_file, tmp_path, monkeypatch
):
    page = track_window.window.track
    track = _child(track_window, TrackController)
    track_frames = track_recording.track_frames

    def waits_for_the_end(indices, read_depth, progress, on_frame):
        track_frames(indices[:1], read_depth, progress, on_frame)
        while True:  # until it is cancelled
            progress.step(0.3, "")

    monkeypatch.setattr(track_recording, "track_frames", waits_for_the_end)
    qtbot.mouseClick(page.run_bar.start_button, Qt.MouseButton.LeftButton)
    qtbot.waitUntil(lambda: page.run_bar.bar.value() == 300, timeout=LIMIT_MS)
    qtbot.mouseClick(page.run_bar.cancel_button, Qt.MouseButton.LeftButton)
    qtbot.waitUntil(lambda: page.sentence.text() == "cancelled", timeout=LIMIT_MS)
    assert page.run_bar.start_button.isVisible()
    monkeypatch.undo()
    _run(track_window, qtbot, "depth")
    other = tmp_path / "other.h5"
    other.write_bytes(touch_file.read_bytes())
    track_window.open_recording(other, keeps_choices=True)
    assert track.view is None
    assert page.plot.n_steps == 0
    assert wait_until_shown(track_window, LIMIT_S)


def test_a_track_opens_without_a_recording_and_goes_with_the_next_one(
    open_window, qtbot, touch_file, tmp_path
):
    (tmp_path / "track.csv").write_text(
        "frame,state,part,x_mm,y_mm,z_mm,rx_deg,ry_deg,rz_deg\n4,tracked,0,1,0,0,0,0,0\n"
    )
    (tmp_path / "track.json").write_text('{"stage": "depth"}')
    controller = open_window()
    controller.open_path(tmp_path)
    track = _child(controller, TrackController)
    qtbot.waitUntil(lambda: track.view is not None, timeout=LIMIT_MS)
    assert controller.window.track.isVisible()
    assert not controller.window.track.run_bar.start_button.isEnabled()
    assert controller.window.track.sentence.text().startswith(
        f"{tmp_path.name}: 1 of 1 frames tracked"
    )
    controller.open_path(touch_file)
    assert track.view is None
    assert controller.window.track.plot.n_steps == 0
    (tmp_path / "track.json").write_text("[")
    controller.open_path(tmp_path)
    qtbot.waitUntil(lambda: "track.json" in controller.window.banner.text, timeout=LIMIT_MS)
