"""The presentation, videos, a picture on the clipboard, and the values around a pixel."""

from __future__ import annotations

import os
import subprocess
import time

import numpy as np
import pytest
from PyQt6.QtCore import QCoreApplication, Qt
from PyQt6.QtGui import QGuiApplication
from PyQt6.QtWidgets import QToolBar

from app.live.live import LiveController
from app.session.sample import SAMPLE_RECORDING
from app.shell.presentation import PresentationController
from app.shell.tour import wait_until_shown
from app.stages.scene import SceneController
from pipeline.core.errors import FileProblem
from pipeline.io.live.source_parsing import SimulatedSource
from pipeline.translation.reports import video
from widgets.views.magnifier import MAX_RADIUS_PX

LIMIT_S = 240


def test_the_magnifier_reads_what_the_probe_reads_and_stays_clear_of_the_pixel(
    bubble_window, qtbot
):
    window = bubble_window.window
    magnifier = bubble_window.findChild(PresentationController).magnifier
    window.resize(1366, 768)
    window.actions_by_name["stage_2"].trigger()
    depth = window.columns["depth"]
    qtbot.waitUntil(lambda: depth.view.canvas.height() > 120, timeout=240_000)
    depth.pixel_hovered.emit("depth", 60, 70)
    assert not magnifier.isVisible()  # it is off
    window.actions_by_name["magnify"].trigger()
    for row, col in ((60, 70), (0, 0), (130, 10)):
        depth.pixel_hovered.emit("depth", row, col)
        assert magnifier.isVisible()
        assert magnifier.parentWidget() is depth.view.canvas
        assert magnifier.format_value(row, col) == f"{depth.view.preview.values[row, col]:.2f}"
        magnifier.grab()  # it can be painted at the picture's border too
        rows = depth.view.preview.pixels.shape[0]
        assert (magnifier.geometry().center().y() > depth.view.canvas.height() / 2) == (
            row < rows / 2
        )
    assert magnifier.format_value(-1, 0) == ""
    assert 1 <= magnifier.radius_px < MAX_RADIUS_PX  # a small picture
    depth.pixel_hovered.emit("depth", -1, -1)
    assert not magnifier.isVisible()
    bubble_window.probe.move_to_pixel("target_depth", 40, 50)  # by keys
    assert magnifier.parentWidget() is window.columns["target_depth"].view.canvas
    window.actions_by_name["magnify"].trigger()
    assert not magnifier.isVisible()


@pytest.mark.parametrize("layout", ["look", "align", "compare"])
def test_the_active_pane_is_copied(bubble_window, layout):
    window = bubble_window.window
    window.actions_by_name[f"layout_{layout}"].trigger()
    assert wait_until_shown(bubble_window, LIMIT_S)
    window.actions_by_name["copy_image"].trigger()
    copied = QGuiApplication.clipboard().pixmap()
    whole = window.size()
    assert (copied.width() == whole.width()) == (layout == "compare")
    assert 100 < copied.width() <= whole.width()
    assert f"{copied.width()} x {copied.height()}" in window.said


def present(controller) -> None:
    controller.window.actions_by_name["full_screen"].trigger()
    assert wait_until_shown(controller, LIMIT_S)


def titles(controller) -> list[str]:
    return [pane._title.text() for pane in controller.window.look.panes if pane.isVisible()]


def test_a_presentation_fills_the_screen_with_the_panes_and_esc_leaves(open_window, qtbot):
    controller = open_window(SAMPLE_RECORDING, source="gelslim", target="soft_bubble", frame=11)
    assert wait_until_shown(controller, LIMIT_S)
    window = controller.window
    window.actions_by_name["layout_compare"].trigger()
    assert wait_until_shown(controller, LIMIT_S)

    def describe_window():
        around = *window.findChildren(QToolBar), window.statusBar(), window.verdict
        shown = [widget.isVisible() for widget in (*around, window.timeline, window.inspector)]
        return window.size(), window.current_layout, window.visible_columns(), shown

    before = describe_window()
    present(controller)
    assert window.isFullScreen()
    assert titles(controller) == [
        "GelSlim (markers), recorded",
        "GelSlim (markers) \N{RIGHTWARDS ARROW} Soft Bubble",
        "Soft Bubble, generated touch: Object",
    ]
    assert not any(describe_window()[3]), "no tool bar, verdict, timeline or inspector"
    panes = [pane for pane in window.look.panes if pane.isVisible()]
    area = sum(pane.width() * pane.height() for pane in panes)
    assert area > 0.95 * window.width() * window.height()
    for pane in panes:
        title = pane._title
        assert title.heightForWidth(title.width()) <= title.height(), "whole"
        assert not any(button.isVisible() for button in pane._buttons.values())
    assert controller.findChild(SceneController).is_moving
    window.activateWindow()
    qtbot.waitUntil(window.isActiveWindow, timeout=240_000)
    qtbot.keyClick(window, Qt.Key.Key_Right)
    assert controller.session.frame == 12
    qtbot.keyClick(window, Qt.Key.Key_Escape)
    assert not window.actions_by_name["full_screen"].isChecked()
    assert wait_until_shown(controller, LIMIT_S)
    qtbot.waitUntil(lambda: describe_window() == before, timeout=240_000)
    assert not window.isFullScreen()
    assert controller.session.frame == 12
    assert not controller.findChild(SceneController).is_moving
    window.actions_by_name["layout_look"].trigger()
    assert all(pane._title.isVisible() == (pane._dims == "scene") for pane in window.look.panes)


def test_nothing_open_is_not_presented(open_window):
    controller = open_window()
    controller.window.actions_by_name["full_screen"].trigger()
    assert not controller.window.is_presenting
    assert not controller.window.actions_by_name["full_screen"].isChecked()


def test_a_live_presentation_is_there_from_the_first_frame(open_window, qtbot):
    controller = open_window(target="gelslim")
    live = next(child for child in controller.children() if isinstance(child, LiveController))
    live.watch_source(SimulatedSource(sensor="digit", rate_hz=30.0))
    qtbot.waitUntil(lambda: controller.views.translation is not None, timeout=240_000)
    controller.window.actions_by_name["full_screen"].trigger()
    views = [controller.window.columns[name].view for name in ("source", "touch")]
    qtbot.waitUntil(lambda: all(view.preview is not None for view in views), timeout=240_000)
    assert controller.window.is_presenting
    shown = set()
    end_s = time.monotonic() + LIMIT_S
    while len(shown) < 12 and time.monotonic() < end_s:
        QCoreApplication.processEvents()
        assert all(view.preview is not None for view in views)
        shown.add(id(views[0].preview))
        time.sleep(0.01)
    assert len(shown) >= 12


def test_ffmpeg_encodes_what_it_is_given(tmp_path, monkeypatch):
    """A stand-in with ffmpeg's options: it keeps the raw frames that arrive."""
    program = tmp_path / "ffmpeg"
    program.write_text(
        "#!/bin/sh\nfor last; do :; done\n[ \"$2\" = -encoders ] && echo ' V....D libx264 H.264' "
        '|| cat > "$last"\n'
    )
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    monkeypatch.setattr(video, "count_frames", lambda _: 2)  # which the stand-in's file has not
    assert video.find_h264_encoder() == str(program)
    frames = (np.full((2, 4, 3), level, np.uint8) for level in (1, 2))
    assert video.write_video(tmp_path / "video.mp4", frames, 10.0) == "H.264"
    assert (tmp_path / "video.mp4").read_bytes() == b"\x01" * 24 + b"\x02" * 24


@pytest.mark.parametrize("reads", ["cat > /dev/null;", ""])
def test_an_ffmpeg_that_does_nothing_is_ended_with_all_that_it_started(
    tmp_path, monkeypatch, reads
):
    program = tmp_path / "ffmpeg"
    mark = f"600.{os.getpid()}"
    program.write_text(
        f'#!/bin/sh\n[ "$2" = -encoders ] && echo " libx264 " && exit\n{reads} sleep {mark} & '
        "wait\n"
    )
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    monkeypatch.setattr(video, "_STALL_S", 0.5)
    monkeypatch.setattr(video, "_FINISH_S", 0.5)
    frames = (np.zeros((480, 640, 3), np.uint8) for _ in range(3))
    with pytest.raises(FileProblem, match=r"did nothing for .*out\.mp4"):
        video.write_video(tmp_path / "out.mp4", frames, 10.0)
    assert (
        subprocess.run(["pgrep", "-f", f"^sleep {mark}"], check=False, capture_output=True).stdout
        == b""
    )
    assert not (tmp_path / "out.mp4").exists()
