"""Sensors that are there now: read, lost, found again, zeroed, recorded and scrubbed back through."""

from __future__ import annotations

import errno
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from pipeline.base.errors import FileProblem, SettingProblem
from pipeline.cli.main import build_app, run_app
from pipeline.live import reader, reference_capture, usb_camera
from pipeline.live.folder_source import FolderSource
from pipeline.live.reader import LiveReader
from pipeline.live.recorder import LiveRecorder
from pipeline.live.simulated_source import SimulatedSource
from pipeline.live.source import LiveFrame, LiveSourceLost
from pipeline.live.usb_camera import UsbCameraSource, list_usb_cameras
from pipeline.recordings import hdf5, mounts, open_recording
from pipeline.sensors.spec import load_sensor

LIMIT_S = 60.0
SCRIPT = Path(sys.executable).with_name("tactoscope")
DIGIT = load_sensor("digit")


def until(met: Callable[[], bool]) -> None:
    end_s = time.monotonic() + LIMIT_S
    while not met():
        assert time.monotonic() < end_s, "not in time"
        time.sleep(0.005)


class Counted:
    """A sensor whose pictures are their numbers; it can be pulled out."""

    title, sensor, touching_object = "counted", "digit", None

    def __init__(self, *, every_s: float = 0.002, skip: int = 0) -> None:
        self.plugged, self._every_s, self._skip, self._n = True, every_s, skip, 0

    def open(self) -> None:
        if not self.plugged:
            raise LiveSourceLost("it is not there")

    def read(self) -> LiveFrame:
        if not self.plugged:
            raise LiveSourceLost("it is gone")
        time.sleep(self._every_s)
        number, self._n = self._n, self._n + 1 + self._skip
        image = np.full((*DIGIT.camera.shape, 3), 100 + number % 2, np.uint8)
        return LiveFrame(image=image, time_s=time.monotonic(), sequence_number=number)

    def close(self) -> None:
        pass


class Shown(Counted):
    """One whose picture is told."""

    def __init__(self, image) -> None:
        super().__init__()
        self.image, self.opened = image, 0

    def open(self) -> None:
        self.opened += 1

    def read(self) -> LiveFrame:
        return replace(super().read(), image=self.image)


@pytest.fixture
def running():
    made: list[LiveReader] = []

    def start(source, **options) -> LiveReader:
        made.append(LiveReader(source, **options))
        made[-1].start()
        return made[-1]

    yield start
    for one in made:
        assert one.stop(LIMIT_S)


def test_a_simulated_sensor_gives_touches_with_their_truth_and_an_untouched_zero(running):
    watched = running(SimulatedSource(sensor="digit", rate_hz=60.0))
    until(lambda: watched.n_frames > 30)
    status = watched.status()
    assert status.state == "running"
    assert status.rate_hz > 0
    deepest = [float(watched.truth(i).indentation_mm.max()) for i in range(watched.first_index, watched.n_frames)]
    assert deepest[0] == 0.0
    assert max(deepest) > 0.1
    last = watched.frame(watched.n_frames - 1)
    assert last.image.shape == last.reference.shape == (*DIGIT.camera.shape, 3)
    recording = watched.make_recording(Path("live:/a"))
    assert recording.object_mesh.name
    assert recording.symmetry is not None
    still = watched.frame(watched.first_index)
    assert np.abs(still.image.astype(float) - last.reference).mean() < 3.0  # noise alone


def test_an_unplugged_sensor_is_told_and_taken_up_again(running, monkeypatch):
    monkeypatch.setattr(reader, "RETRY_S", 0.01)
    source = Counted()
    watched = running(source)
    until(lambda: watched.n_frames > 10)
    source.plugged = False
    until(lambda: watched.status().state == "lost")
    before = watched.n_frames
    assert watched.status().rate_hz == 0.0
    assert "not there" in watched.status().message or "gone" in watched.status().message
    assert watched.frame(before - 1).index == before - 1  # what came can still be looked at
    source.plugged = True
    until(lambda: watched.n_frames > before + 5)
    assert watched.status().state == "running"
    assert watched.status().message == ""


def test_lost_frames_are_counted_and_a_drivers_own_errors_end_nothing(running, monkeypatch):
    monkeypatch.setattr(reader, "RETRY_S", 0.01)
    source = Counted(skip=2)
    watched = running(source)
    until(lambda: watched.n_frames > 10)
    assert watched.status().n_lost == pytest.approx(2 * (watched.n_frames - 1), abs=6)
    right = source.read
    source.read = lambda: 1 / 0
    until(lambda: watched.status().state == "lost")
    assert "ZeroDivisionError" in watched.status().message
    source.read = right
    until(lambda: watched.status().state == "running")


def test_memory_is_bounded_and_old_frames_say_that_they_are_gone(running):
    size = 3 * DIGIT.camera.rows * DIGIT.camera.cols
    watched = running(Counted(every_s=0.0005), most_bytes=30 * size)
    until(lambda: watched.n_frames > 60)
    assert 0 < watched.n_frames - watched.first_index <= 31
    with pytest.raises(FileProblem, match="frame 0 is not held any more"):
        watched.frame(0)


def test_zero_is_the_median_of_the_last_readings_and_says_when_it_is_none():
    rng = np.random.default_rng(0)
    still = [np.clip(rng.normal(120, 2, (*DIGIT.camera.shape, 3)), 0, 255).astype(np.uint8) for _ in range(15)]
    reference = reference_capture.compute_median_image(still)
    assert np.abs(reference.astype(float) - 119.5).mean() < 0.7  # one picture's: 1.6
    assert reference_capture.check_motion(still, DIGIT) == ""
    touched = still[-1].copy()
    touched[100:200, 80:160] += 60
    assert "touched or moved" in reference_capture.check_motion([*still[:-1], touched], DIGIT)
    assert reference_capture.check_drift(touched, reference, DIGIT) == ""  # a touch is no drift
    assert "set zero again" in reference_capture.check_drift(still[0] + 40, reference, DIGIT)


def test_zero_with_something_on_the_gel_is_noticed(running):
    plain = np.full((*DIGIT.camera.shape, 3), 110, np.uint8)
    touched = plain.copy()
    touched[100:200, 80:160] += 60  # and it rests there
    source = Shown(plain)
    watched = running(source)
    until(lambda: watched.has_reference)
    assert watched.status().message == ""
    source.image = touched
    n = watched.n_frames
    until(lambda: watched.n_frames > n + 2 * reference_capture.MAX_FRAMES)
    for _ in range(2):  # asking twice does not make it right
        assert "as where something touches" in watched.capture_reference()
    source.image = plain + 30  # the light of the room is no touch
    n = watched.n_frames
    until(lambda: watched.n_frames > n + 2 * reference_capture.MAX_FRAMES)
    assert watched.capture_reference() == ""


def test_a_device_that_gives_another_size_midway_is_said_and_zeroed_anew(running, tmp_path):
    source = Shown(np.full((*DIGIT.camera.shape, 3), 110, np.uint8))
    watched = running(source)
    recorder = LiveRecorder(tmp_path / "a.h5", "test")
    until(lambda: watched.has_reference)
    watched.set_listener(recorder.offer)
    until(lambda: recorder.n_written > 2)
    source.image = np.full((120, 160, 3), 90, np.uint8)
    until(lambda: bool(recorder.problem))
    watched.set_listener(None)
    assert recorder.close()
    until(lambda: watched.frame(watched.n_frames - 1).reference is not None)
    newest = watched.frame(watched.n_frames - 1)
    assert newest.reference.shape == newest.image.shape == (120, 160, 3)
    assert watched.status().state == "running", "no driver failed"
    assert source.opened == 1
    kept = open_recording(tmp_path / "a.h5")
    assert kept.streams[0].n_frames == recorder.n_written
    kept.close()


def test_a_bubbles_zero_keeps_gaps_only_where_most_readings_have_them():
    readings = [np.full((4, 4), 90.0 + i, np.float32) for i in range(3)]
    readings[0][0, 0] = np.nan
    for one in readings[:2]:
        one[1, 1] = np.nan
    reference = reference_capture.compute_median_image(readings)
    assert reference[0, 0] == pytest.approx(91.5)
    assert np.isnan(reference[1, 1])
    assert reference[2, 2] == 91.0


def test_a_folder_shows_the_newest_whole_picture_and_counts_the_others(tmp_path):
    shape = (*DIGIT.camera.shape, 3)

    def write(name: str, grey: int, age_s: float) -> None:
        cv2.imwrite(str(tmp_path / name), np.full(shape, grey, np.uint8))
        os.utime(tmp_path / name, (time.time() - age_s,) * 2)

    write("before.png", 10, 100.0)
    source = FolderSource(tmp_path, sensor="digit")
    source.open()
    assert source.read() is None  # what was there before is not watched
    for i in range(3):
        write(f"{i}.png", 50 + i, 3.0 - i)
    (tmp_path / "half.png").write_bytes((tmp_path / "2.png").read_bytes()[:500])
    newest = source.read()
    assert newest.image[0, 0].tolist() == [52, 52, 52]
    assert newest.sequence_number == 3
    shutil.copy(tmp_path / "0.png", tmp_path / "half.png")  # it is whole now
    assert source.read().image[0, 0].tolist() == [50, 50, 50]
    shutil.rmtree(tmp_path)
    with pytest.raises(LiveSourceLost, match="is gone"):
        source.read()


def test_a_camera_is_found_by_name_and_serial_and_not_by_its_second_node(tmp_path):
    for name in ("usb-Facebook_DIGIT_D20123-video-index0", "usb-Facebook_DIGIT_D20123-video-index1",
                 "usb-Arducam_GelSight_Mini_R0B_28WZ-video-index0", "usb-HD_Webcam-video-index0"):  # fmt: skip
        (tmp_path / name).touch()
    cameras = list_usb_cameras(tmp_path)
    assert [camera.profile.sensor for camera in cameras] == ["gelsight_mini", "digit", ""]
    assert all(camera.node.name.endswith("index0") for camera in cameras)
    asked = []

    def opened(node, kind):
        asked.append((node.name, kind.sensor, kind.size_px))
        return _Stream(np.zeros((240, 320, 3), np.uint8))

    source = UsbCameraSource("d20123", by_id=tmp_path, opener=opened)
    source.open()
    assert asked == [("usb-Facebook_DIGIT_D20123-video-index0", "digit", (320, 240))]
    with pytest.raises(LiveSourceLost, match="there are: "):
        UsbCameraSource("D99999", by_id=tmp_path).open()


class _Stream:
    """What OpenCV gives of a camera."""

    def __init__(self, bgr: np.ndarray) -> None:
        self._bgr = bgr

    def isOpened(self) -> bool:
        return True

    def read(self):
        return (self._bgr is not None), self._bgr

    def release(self) -> None:
        self._bgr = None


def test_a_digits_stream_is_turned_as_its_own_driver_turns_it_and_its_end_is_a_loss(tmp_path):
    bgr = np.zeros((240, 320, 3), np.uint8)
    bgr[0, 0] = (255, 0, 0)  # blue, above left of the raw picture
    stream = _Stream(bgr)
    source = UsbCameraSource("DIGIT", by_id=_node(tmp_path), opener=lambda node, kind: stream)
    source.open()
    image = source.read().image
    assert image.shape == (320, 240, 3)
    assert image[319, 0].tolist() == [0, 0, 255]
    stream.release()
    with pytest.raises(LiveSourceLost, match="no picture comes"):
        source.read()


def test_a_gelsight_minis_whole_camera_is_cut_and_made_smaller(tmp_path):
    stream = _Stream(np.full((2464, 3280, 3), 90, np.uint8))
    source = UsbCameraSource("GelSight", by_id=_node(tmp_path, "GelSight_Mini_R0B"), opener=lambda node, kind: stream)
    source.open()
    assert source.read().image.shape == (*load_sensor("gelsight_mini").camera.shape, 3)
    assert source.sensor == "gelsight_mini"


def _node(folder: Path, name: str = "Facebook_DIGIT_D1") -> Path:
    (folder / f"usb-{name}-video-index0").touch()
    return folder


def test_a_recorded_stream_goes_through_the_cameras_own_code(tmp_path, running, monkeypatch):
    monkeypatch.setattr(reader, "RETRY_S", 0.01)
    path, size = tmp_path / "stream.avi", (240, 320)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 30.0, size)
    for i in range(20):
        writer.write(np.full((320, 240, 3), 100 + i, np.uint8))
    writer.release()
    watched = running(UsbCameraSource(str(path), sensor="gelsight_mini"))
    until(lambda: watched.n_frames > 30)  # it ended once, and was opened again
    assert watched.frame(watched.n_frames - 1).image.shape == (*load_sensor("gelsight_mini").camera.shape, 3)


def test_what_is_watched_opens_as_a_recording_that_grows(running):
    watched, path = running(Counted()), Path("live:/counted")
    until(lambda: watched.n_frames > 20)
    mounts.mount(path, lambda: watched.make_recording(path))
    try:
        recording = open_recording(path)
        n = recording.streams[0].n_frames
        until(lambda: watched.n_frames > n)
        assert recording.refresh().streams[0].n_frames > n
        assert recording.streams[0].frame(n - 1).index == n - 1
    finally:
        mounts.unmount(path)
    with pytest.raises(FileProblem, match="no such file"):
        open_recording(path)


def test_a_recording_can_be_read_while_it_grows_and_holds_what_was_watched(tmp_path, running):
    watched = running(SimulatedSource(sensor="digit", rate_hz=120.0))
    until(lambda: watched.n_frames > 10)
    recorder = LiveRecorder(tmp_path / "a.h5", "test")
    watched.set_listener(recorder.offer)
    until(lambda: recorder.n_written > 5)
    meanwhile = hdf5.read(tmp_path / "a.h5")
    assert meanwhile.streams[0].n_frames > 0
    assert meanwhile.streams[0].frame(0).image.any()
    meanwhile.close()
    watched.set_listener(None)
    assert recorder.close()
    whole = hdf5.read(tmp_path / "a.h5")
    stream = whole.streams[0]
    assert stream.n_frames == recorder.n_written
    assert not any(hdf5.NOT_CLOSED_NOTE in note for note in whole.notes)
    first = stream.frame(0)
    held = next(
        watched.frame(i)
        for i in range(watched.first_index, watched.n_frames)
        if watched.frame(i).time_s == first.time_s
    )
    assert np.array_equal(first.image, held.image)
    assert np.array_equal(first.reference, held.reference)
    whole.close()


def test_a_recording_outlives_a_kill_at_any_moment(tmp_path):
    path = tmp_path / "killed.h5"
    command = [SCRIPT, "live", "--sensor", "digit", "--rate", "60", "--record", path]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as other:
        for line in other.stdout:
            if " recorded" in line and int(line.split(" recorded")[0].split()[-1]) > 10:
                break
        other.send_signal(signal.SIGKILL)
    recording = open_recording(path)
    stream = recording.streams[0]
    assert any(hdf5.NOT_CLOSED_NOTE in note for note in recording.notes)
    assert stream.n_frames > 5
    for index in range(stream.n_frames):
        assert stream.frame(index).image.shape == (*DIGIT.camera.shape, 3)
        assert stream.truth(index).indentation_mm is not None
    recording.close()
    assert run_app(build_app(), ["inspect", str(path)]) == 0


def full_from(monkeypatch: pytest.MonkeyPatch, n_bytes: int) -> None:
    """Let files grow to `n_bytes` and no farther, as a disk that is full then."""
    plenty = os.posix_fallocate

    def taken(descriptor: int, offset: int, length: int) -> None:
        if length > n_bytes:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        plenty(descriptor, offset, length)

    monkeypatch.setattr(os, "posix_fallocate", taken)


def test_a_disk_that_is_full_is_said_and_what_was_recorded_stays(tmp_path, running, monkeypatch, capsys):
    watched = running(SimulatedSource(sensor="digit", rate_hz=120.0))
    until(lambda: watched.n_frames > 10)
    full_from(monkeypatch, 4 << 20)
    path = tmp_path / "a.h5"
    recorder = LiveRecorder(path, "test")
    watched.set_listener(recorder.offer)
    until(lambda: bool(recorder.problem))
    watched.set_listener(None)
    assert recorder.close()
    assert "cannot write the recording (No space left on device)" in recorder.problem
    kept = open_recording(path)
    assert kept.streams[0].n_frames == recorder.n_written > 0
    assert kept.streams[0].frame(recorder.n_written - 1).image.any()
    kept.close()

    full_from(monkeypatch, 0)
    assert run_app(build_app(), ["live", "--record", str(tmp_path / "b.h5"), "--seconds", "2"]) == 2
    assert "No space left on device" in capsys.readouterr().err
    assert not (tmp_path / "b.h5").exists()


def test_a_recording_of_nothing_leaves_no_file(tmp_path):
    recorder = LiveRecorder(tmp_path / "a.h5", "test")
    assert recorder.close()
    assert recorder.n_written == 0
    assert not any(tmp_path.iterdir())


def test_the_command_says_what_arrives(capsys, tmp_path):
    assert run_app(build_app(), ["live", "--source", "simulated", "--sensor", "digit", "--seconds", "2.5"]) == 0
    said = capsys.readouterr().out
    assert "running: " in said
    assert " Hz, " in said
    assert run_app(build_app(), ["live", "--source", "folder", str(tmp_path / "none"), "--seconds", "1.2"]) == 1
    assert "there is no folder" in capsys.readouterr().out
    assert run_app(build_app(), ["live", "--list"]) == 0


@pytest.mark.parametrize("words", [("nothing",), ("folder",), ("device", "a", "b")])
def test_words_that_are_no_source_are_told(words):
    from pipeline.live.source_parsing import parse_source

    with pytest.raises(SettingProblem, match="a source is simulated, folder DIR or device NAME"):
        parse_source(words)


def test_the_light_of_a_digit_is_full():
    assert next(kind for kind in usb_camera.USB_CAMERA_PROFILES if kind.sensor == "digit").led_setting == 0xFFF


def test_too_few_readings_to_record_are_no_success(tmp_path, capsys):
    words = ["live", "--sensor", "digit", "--rate", "3", "--record", str(tmp_path / "a.h5"), "--seconds", "1.5"]
    assert run_app(build_app(), words) == 1
    assert "the first 7 readings are taken as untouched" in capsys.readouterr().out
    assert not (tmp_path / "a.h5").exists()


@pytest.mark.parametrize("words", [["folder", "a b/c"], ["folder a b/c"]])
def test_a_source_in_quotes_is_the_same_as_in_words(words):
    from pipeline.live.source_parsing import parse_source

    source = parse_source(words, sensor="digit")
    assert isinstance(source, FolderSource)
    with pytest.raises(LiveSourceLost, match="there is no folder 'a b/c'"):
        source.open()
