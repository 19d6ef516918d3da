"""A sensor in the window: the newest frame is shown, the window waits for nothing, looking back
stays where it is.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PyQt6.QtCore import QCoreApplication
from PyQt6.QtWidgets import QLabel

from app.live.live import LiveController
from app.shell.tour import wait_until_shown
from pipeline.io import open_recording
from pipeline.io.live import reader
from pipeline.io.live.source import LiveFrame, LiveSourceLost
from pipeline.io.live.source_parsing import SimulatedSource, parse_sources
from pipeline.sensors.spec import load_sensor

LIMIT_S = 240


def living_of(controller) -> LiveController:
    return next(child for child in controller.children() if isinstance(child, LiveController))


def until(met: Callable[[], bool]) -> None:
    end_s = time.monotonic() + LIMIT_S
    while not met():
        assert time.monotonic() < end_s, "not in time"
        QCoreApplication.processEvents()
        time.sleep(0.003)


@pytest.fixture
def watching(open_window, monkeypatch):
    monkeypatch.setattr(reader, "RETRY_S", 0.02)
    controller = open_window(target="gelslim")
    living = living_of(controller)
    living.watch_source(SimulatedSource(sensor="digit", rate_hz=30.0))
    until(lambda: living.is_on_screen and controller.latest_frame is not None)
    return controller, living


def test_the_newest_frame_follows_and_looking_back_stays(watching):
    controller, living = watching
    first = controller.latest_frame.index
    until(lambda: controller.latest_frame.index > first + 3)
    assert "Hz" in living.live_bar.text
    assert controller.window.timeline.slider.maximum() >= controller.latest_frame.index
    controller.window.timeline.frame_chosen.emit(first)
    controller.window.timeline.step_to(first)
    assert not living.is_following
    assert wait_until_shown(controller, LIMIT_S)
    n = living.reader.n_frames
    until(lambda: living.reader.n_frames > n + 5)
    assert controller.session.frame == first
    assert controller.window.timeline.slider.maximum() >= n
    living.live_bar.follow.click()
    until(lambda: controller.latest_frame.index > n)


def test_what_the_partner_took_is_the_truth_on_screen(open_window):
    controller = open_window(target="soft_bubble")
    living = living_of(controller)
    words = ["simulated"]
    living.watch_source(*parse_sources(words, words, sensor="gelslim", target="soft_bubble"))
    until(lambda: living.is_on_screen and controller.latest_frame is not None)
    until(lambda: "touch.depth_mae_mm" in controller.latest_frame.metrics)
    assert "partner running" in living.live_bar.text
    until(lambda: not living.live_bar.findChild(QLabel, "live_partner").pixmap().isNull())


def test_an_unplugged_sensor_is_reported_and_followed_again(watching, monkeypatch):
    def lose():
        raise LiveSourceLost("it was unplugged")

    controller, living = watching
    with monkeypatch.context() as unplugged:
        unplugged.setattr(living.reader.source, "open", lose)
        unplugged.setattr(living.reader.source, "read", lose)
        until(lambda: "unplugged" in living.live_bar.text)
        assert not controller.window.banner.isVisible()
        before = living.reader.n_frames
    until(lambda: controller.latest_frame.index > before)


def test_recording_a_live_source_leaves_a_complete_file(watching, tmp_path):
    _, living = watching
    path = tmp_path / "watched.h5"
    living.start_recording(path)
    until(lambda: living.recorder.n_written > 4)
    living.stop_recording()
    living.stop_watching()
    until(lambda: _is_whole(path))
    with_truth = open_recording(path)
    assert with_truth.streams[0].n_frames > 4
    assert with_truth.streams[0].has_truth
    with_truth.close()


def _is_whole(path: Path) -> bool:
    recording = open_recording(path)
    recording.close()
    return not any("not closed" in note for note in recording.notes)


class _Hangs:
    """A camera that does not come back, as one does whose cable is half out."""

    title = "hanging"
    sensor = "digit"
    touching_object = None

    def __init__(self) -> None:
        self.n = 0
        self.hang = False
        self.hangs = threading.Event()
        self.released = threading.Event()

    def open(self) -> None:
        pass

    def read(self) -> LiveFrame | None:
        if self.hang:
            self.hangs.set()
            self.released.wait()
        time.sleep(0.01)
        self.n += 1
        image = np.full((*load_sensor("digit").camera.shape, 3), 60, np.uint8)
        return LiveFrame(image=image, time_s=time.monotonic(), sequence_number=self.n)

    def close(self) -> None:
        pass


def test_the_window_does_not_wait_for_a_camera(open_window):
    controller = open_window(target="gelslim")
    source = _Hangs()
    living = living_of(controller)
    living.watch_source(source)
    until(lambda: living.is_on_screen and controller.latest_frame is not None)
    source.hang = True
    source.hangs.wait()
    try:
        living.set_zero()
        living.stop_watching()
        controller.close()  # comes back while the read hangs
    finally:
        source.released.set()
