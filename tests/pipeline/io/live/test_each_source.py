"""Every kind of live source by its real part, and what happens to sensors in a laboratory.

| source | dies and returns | other size | grey | 16 bits | clock jumps | frames lost |
| --- | --- | --- | --- | --- | --- | --- |
| MJPEG over HTTP | yes | yes | yes | a JPEG has 8 | no stamps | cannot be told |
| OpenCV on a pipe | yes | yes | yes | a JPEG has 8 | no stamps | cannot be told |
| Foxglove bridge, colour | yes | yes | yes | yes | yes | yes |
| Foxglove bridge, depth | yes | yes | is depth | yes | yes | yes |
| RealSense | yes | fixed by its profile | is depth | yes | yes | yes |
| growing folder | yes | yes | yes | yes | no stamps | `test_live.py` |
"""

from __future__ import annotations

import os
from contextlib import ExitStack, suppress

import cv2
import foxglove
import numpy as np
import pytest
from foxglove.channels import RawImageChannel

from pipeline.io.live import reader as live_reader
from pipeline.io.live import realsense
from pipeline.io.live.reader import LiveReader
from pipeline.io.live.realsense import RealSenseSource
from pipeline.io.live.source_parsing import parse_source
from pipeline.sensors.spec import load_sensor
from tests.pipeline.io.live.streams import (
    make_coloured,
    make_raw,
    publishing,
    serve_mjpeg,
    wait_until,
)
from tests.pipeline.io.live.test_realsense import COLS, ROWS, SoftCamera

DIGIT = load_sensor("digit").camera.shape
BUBBLE = load_sensor("soft_bubble").camera.shape


class Part:
    """The real part of a source, which shows `image` with the stamp of its clock until it dies."""

    sensor = "digit"
    has_stamps = False

    def __init__(self, folder, stack: ExitStack) -> None:
        self.folder = folder
        self.stack = stack
        self.image = make_coloured(DIGIT)
        self.is_alive = True
        self.clock_s = 10_000.0
        self.lost: tuple[int, ...] = ()
        self.n = 0
        self.begin()

    def begin(self) -> None:
        pass

    def make_source(self):
        return parse_source([self.words], sensor=self.sensor)

    def show(self, _n: int) -> None:
        if self.is_alive:
            self.n += 1
            if self.n not in self.lost:
                self.send()

    def die(self) -> None:
        self.is_alive = False

    def revive(self) -> None:
        self.is_alive = True


class Http(Part):
    def begin(self) -> None:
        self.images = [self.image]
        self.words, self.ended = self.stack.enter_context(serve_mjpeg(self.images))

    def send(self) -> None:
        self.images[0] = self.image

    def die(self) -> None:
        self.ended.set()

    def revive(self) -> None:
        self.ended.clear()


class Pipe(Part):
    """JPEGs in a pipe, which OpenCV reads like a camera."""

    def begin(self) -> None:
        self.path = self.folder / "camera.mjpeg"
        os.mkfifo(self.path)
        self.words = f"device {self.path}"
        self.file = None
        self.stack.callback(self.die)

    def send(self) -> None:
        jpeg = cv2.imencode(".jpg", self.image[..., ::-1])[1].tobytes()
        with suppress(OSError):  # nobody reads
            if self.file is None:
                self.file = os.fdopen(os.open(self.path, os.O_WRONLY | os.O_NONBLOCK), "wb", 0)
                os.set_blocking(self.file.fileno(), True)
            self.file.write(jpeg)

    def die(self) -> None:
        super().die()
        file, self.file = self.file, None
        if file is not None:
            file.close()


class Bridge(Part):
    encoding = "rgb8"
    has_stamps = True
    port = 0

    def begin(self) -> None:
        self.context = foxglove.Context()
        self.channel = RawImageChannel("/sensor/image", context=self.context)
        self.revive()
        self.stack.callback(self.die)

    def send(self) -> None:
        encoding = self.encoding if self.image.ndim == 3 or self.sensor != "digit" else "mono8"
        encoding = "16UC1" if self.image.dtype == np.uint16 else encoding
        self.channel.log(make_raw(self.image, encoding, self.clock_s + 0.02 * self.n))

    def die(self) -> None:
        super().die()
        if self.server is not None:
            self.server.stop()
        self.server = None

    def revive(self) -> None:
        super().revive()
        self.server = None
        wait_until(self._serve)
        self.port = self.server.port
        self.words = f"ws://127.0.0.1:{self.port}"

    def _serve(self) -> bool:
        with suppress(RuntimeError):  # who looks for the server holds its port for a moment
            self.server = foxglove.start_server(
                host="127.0.0.1", port=self.port, context=self.context
            )
        return self.server is not None


class DepthBridge(Bridge):
    sensor = "soft_bubble"

    def begin(self) -> None:
        self.image = np.full(BUBBLE, 75, np.uint16)
        super().begin()


class RealSense(Part):
    sensor = "soft_bubble"
    has_stamps = True

    def begin(self) -> None:
        self.image = np.full((ROWS, COLS), 750, np.uint16)
        self.camera = SoftCamera()

    def make_source(self):
        return RealSenseSource(device=self.camera.device)

    def send(self) -> None:
        self.camera.send(self.image, self.n, 1e3 * self.clock_s + 20.0 * self.n)


class Folder(Part):
    def begin(self) -> None:
        self.place = self.folder / "growing"
        self.place.mkdir()
        self.words = f"folder {self.place}"

    def send(self) -> None:
        image = self.image[..., ::-1] if self.image.ndim == 3 else self.image
        cv2.imwrite(str(self.place / f"{self.n:06}.png"), image)

    def die(self) -> None:
        super().die()
        self.place.rename(self.folder / "away")

    def revive(self) -> None:
        (self.folder / "away").rename(self.place)
        super().revive()


class DepthFolder(Folder):
    sensor = "soft_bubble"

    def begin(self) -> None:
        self.image = np.full(BUBBLE, 75, np.uint16)
        super().begin()


PARTS = (Http, Pipe, Bridge, DepthBridge, RealSense, Folder)
GELS = (Http, Pipe, Bridge, Folder)


@pytest.fixture
def watch(tmp_path, monkeypatch):
    """Starts the part, whose images come every 20 ms, and a reader of it."""
    monkeypatch.setattr(live_reader, "RETRY_S", 0.02)
    monkeypatch.setattr(realsense, "_SILENCE_S", 0.4)
    with ExitStack() as stack:

        def start(kind, image=None) -> tuple[Part, LiveReader]:
            part = kind(tmp_path, stack)
            part.image = part.image if image is None else image
            part.send()
            reader = LiveReader(part.make_source())
            stack.enter_context(publishing(part.show, 0.02))
            stack.callback(reader.stop, 5.0)
            reader.start()
            return part, reader

        yield start


@pytest.mark.parametrize("kind", PARTS)
def test_a_source_that_dies_is_said_and_its_numbering_goes_on(kind, watch):
    part, reader = watch(kind)
    wait_until(lambda: reader.n_frames > 3)
    part.die()
    wait_until(lambda: reader.status().state == "lost")
    assert reader.status().message
    n = reader.n_frames
    part.revive()
    wait_until(lambda: reader.n_frames > n + 3)
    assert reader.frame(n).index == n
    status = reader.status()
    assert (status.state, status.message) == ("running", "")


@pytest.mark.parametrize("kind", [Http, Pipe, Bridge, DepthBridge, Folder])
def test_an_image_of_another_size_is_said_or_left_out(kind, watch):
    part, reader = watch(kind)
    wait_until(lambda: reader.has_reference)
    usual = part.image
    shape = reader.frame(0).image.shape
    part.image = np.ascontiguousarray(usual[:120, :160])
    n = part.n
    wait_until(lambda: part.n > n + 20)
    newest = reader.frame(reader.n_frames - 1)
    assert newest.reference is None or newest.reference.shape == newest.image.shape
    part.image = usual
    n = reader.n_frames
    wait_until(lambda: reader.n_frames > n + 10)
    wait_until(lambda: reader.frame(reader.n_frames - 1).image.shape == shape)
    assert reader.status().state == "running"


@pytest.mark.parametrize("kind", GELS)
def test_grey_images_of_a_gel_are_refused_in_a_sentence(kind, watch):
    grey = np.zeros(DIGIT, np.uint8) + 90
    grey[::7, ::5] = 20
    is_plain = kind in (Bridge, Folder)
    _, reader = watch(kind, grey if is_plain else np.repeat(grey[..., None], 3, axis=2))
    wait_until(lambda: "grey" in reader.status().message)
    assert "in colour" in reader.status().message


@pytest.mark.parametrize("kind", [Bridge, Folder])
def test_images_of_16_bits_are_no_gels_and_that_is_said(kind, watch):
    _, reader = watch(kind, np.full(DIGIT, 30_000, np.uint16))
    wait_until(lambda: "16 bits" in reader.status().message)
    assert "--sensor" in reader.status().message


@pytest.mark.parametrize("kind", [DepthBridge, RealSense, DepthFolder])
def test_16_bits_of_a_bubble_are_depth(kind, watch):
    _, reader = watch(kind)
    wait_until(lambda: reader.has_reference)
    frame = reader.frame(reader.n_frames - 1)
    assert frame.is_depth
    assert float(np.median(frame.image)) == pytest.approx(75.0)


@pytest.mark.parametrize("kind", [part for part in PARTS if part.has_stamps])
@pytest.mark.parametrize("jump_s", [3600.0, -3600.0])
def test_a_clock_that_jumps_is_counted_and_moves_no_frame(kind, jump_s, watch):
    part, reader = watch(kind)
    wait_until(lambda: reader.n_frames > 10)
    before = reader.status().n_clock_jumps
    part.clock_s += jump_s
    n = reader.n_frames
    wait_until(lambda: reader.n_frames > n + 10)
    assert reader.status().n_clock_jumps > before
    times_s = [reader.frame(i).time_s for i in range(reader.n_frames)]
    assert times_s == sorted(times_s)
    assert times_s[-1] - times_s[0] < 600.0


@pytest.mark.parametrize("kind", [Bridge, DepthBridge, RealSense])
def test_lost_frames_are_counted(kind, watch):
    part, reader = watch(kind)
    wait_until(lambda: reader.n_frames > 30)
    before = reader.status().n_lost
    first = part.n + 10
    part.lost = (first,)
    wait_until(lambda: part.n > first + 20)
    assert reader.status().n_lost > before


def test_a_source_of_another_kind_than_its_sensor_is_a_sentence(watch, monkeypatch):
    monkeypatch.setattr(Http, "sensor", "soft_bubble")
    _, reader = watch(Http)
    wait_until(lambda: bool(reader.status().message))
    assert "colour images, which Soft Bubble" in reader.status().message
