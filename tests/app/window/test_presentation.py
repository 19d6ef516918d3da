"""The presentation and its video, a picture on the clipboard, and the values around a pixel."""

from __future__ import annotations

import os
import subprocess
import time

import cv2
import numpy as np
import pytest
from PyQt6.QtCore import QCoreApplication, QSize, Qt
from PyQt6.QtGui import QGuiApplication, QImage
from PyQt6.QtWidgets import QWidget

from app.export.export import ExportController
from app.live.live import LiveController
from app.session.sample import SAMPLE_RECORDING
from app.shell.presentation import PresentationController, PresentationVideoController
from app.shell.tour import wait_until_shown
from pipeline.core.errors import FileProblem
from pipeline.io.live.source_parsing import SimulatedSource
from pipeline.translation.reports import video
from widgets.shell.presentation_view import compose
from widgets.views.magnifier import MAX_RADIUS_PX

LIMIT_S = 240
MEAN_JPEG_GREY = 4.0  # grey levels that MJPEG changes on average in lines and letters


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


def present(controller) -> PresentationController:
    controller.window.actions_by_name["full_screen"].trigger()
    assert wait_until_shown(controller, LIMIT_S)
    return controller.findChild(PresentationController)


def test_a_presentation_shows_images_alone_and_esc_leaves_the_window_as_it_was(open_window, qtbot):
    controller = open_window(SAMPLE_RECORDING, target="soft_bubble", frame=11)
    assert wait_until_shown(controller, LIMIT_S)
    window = controller.window
    before = window.size(), window.current_layout, window.visible_columns(), window.saveState()
    view = present(controller).view
    assert view.isFullScreen()
    assert view.size() == view.screen().geometry().size()
    assert [pane.title for pane in view.panes] == [
        "GelSlim (markers), recorded",
        "Soft Bubble, generated touch: Object",
        "Soft Bubble, recorded",
    ]
    assert view.children() == [] or not view.findChildren(QWidget), (
        "no menu, tool bar, timeline or probe"
    )
    generated = view.panes[1].preview
    recorded = view.panes[2].preview
    assert generated.scale == recorded.scale
    assert generated.scale.high < 10.0, "fitted to the touch"
    qtbot.keyClick(view, Qt.Key.Key_Right)
    assert controller.session.frame == 12
    qtbot.keyClick(view, Qt.Key.Key_Escape)
    assert not window.actions_by_name["full_screen"].isChecked()
    assert wait_until_shown(controller, LIMIT_S)
    assert (
        window.size(),
        window.current_layout,
        window.visible_columns(),
        window.saveState(),
    ) == before
    assert controller.session.frame == 12
    assert all(column.view.preview is not None for column in window.columns.values())


def test_a_recording_without_truth_has_two_panes(bubble_window):
    panes = present(bubble_window).view.panes
    assert [pane.title.partition(",")[0] for pane in panes] == ["Soft Bubble", "GelSlim (markers)"]


def test_nothing_open_is_not_presented(open_window):
    controller = open_window()
    controller.window.actions_by_name["full_screen"].trigger()
    assert controller.findChild(PresentationController).view is None
    assert not controller.window.actions_by_name["full_screen"].isChecked()


def test_a_live_presentation_shows_whole_frames_only(open_window, qtbot):
    """Never less than all panes of one frame, and at full brightness, while the next one is
    computed.
    """
    controller = open_window(target="gelslim")
    live = next(child for child in controller.children() if isinstance(child, LiveController))
    live.watch_source(SimulatedSource(sensor="digit", rate_hz=30.0))
    qtbot.waitUntil(
        lambda: live.is_on_screen and controller.latest_frame is not None, timeout=240_000
    )
    view = present(controller).view
    shown = []
    least = []
    paint = view.paintEvent

    def watch(event) -> None:
        paint(event)
        shown.append(view.panes)
        corner = view.panes[0].preview.pixels if view.panes else None
        image = view._image
        at = image.pixelColor(image.width() // 4, image.height() // 2)
        least.append(max(at.red(), at.green(), at.blue()) if corner is not None else 0)

    view.paintEvent = watch
    end_s = time.monotonic() + LIMIT_S
    while len(set(map(id, shown))) < 12 and time.monotonic() < end_s:
        QCoreApplication.processEvents()
        view.repaint()
        time.sleep(0.01)
    assert len(set(map(id, shown))) >= 12
    assert {len(panes) for panes in shown} == {len(shown[-1])}
    assert min(least) > 0.6 * max(least), "the middle of the source is never dimmed"


def test_the_video_is_the_presentation(open_window, tmp_path, qtbot, monkeypatch):
    controller = open_window(SAMPLE_RECORDING, target="soft_bubble", frame=3)
    assert wait_until_shown(controller, LIMIT_S)
    size = QSize(640, 360)
    path = tmp_path / "shown.avi"
    writer = controller.findChild(PresentationVideoController)
    export = controller.findChild(ExportController)
    writer.write(path, size)
    qtbot.waitUntil(lambda: "Written as MJPEG" in export.notification.text, timeout=240_000)
    assert "H.264 needs an ffmpeg" in export.notification.text
    film = cv2.VideoCapture(str(path))
    frames = [film.read()[1] for _ in range(int(film.get(cv2.CAP_PROP_FRAME_COUNT)))]
    film.release()
    assert len(frames) == 16
    presentation = present(controller)
    for index in range(12):
        controller.choose_frame(index)
        assert wait_until_shown(controller, LIMIT_S)
    composed = compose(presentation.view.panes, size).convertToFormat(QImage.Format.Format_BGR888)
    bits = composed.constBits()
    bits.setsize(composed.sizeInBytes())
    expected = (
        np.frombuffer(bits, np.uint8)
        .reshape(360, composed.bytesPerLine())[:, : 3 * 640]
        .reshape(360, 640, 3)
    )
    difference = np.abs(frames[11].astype(int) - expected)
    assert difference.mean() < MEAN_JPEG_GREY


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
