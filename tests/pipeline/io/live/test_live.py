"""Live sensors: read, lost, opened again, recorded, and their reference captured."""

from __future__ import annotations

import errno
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import cv2
import h5py
import numpy as np
import pytest

from pipeline.cli.main import build_app, run_app
from pipeline.core.errors import FileProblem, SettingProblem
from pipeline.core.values.frames import TactileFrame
from pipeline.io import hdf5, hdf5_writer, mounts, open_recording
from pipeline.io.live import reader, reference_capture, usb_camera
from pipeline.io.live import recorder as live_recorder
from pipeline.io.live.reader import LiveReader, ReaderStatus
from pipeline.io.live.recorder import LiveRecorder
from pipeline.io.live.source import LiveFrame, LiveSourceLost
from pipeline.io.live.source_parsing import FolderSource, SimulatedSource
from pipeline.io.live.usb_camera import UsbCameraSource, list_usb_cameras
from pipeline.sensors.spec import load_sensor

LIMIT_S = 60.0
SCRIPT = Path(sys.executable).with_name("tactoscope")
DIGIT = load_sensor("digit")


def wait_until(condition: Callable[[], bool]) -> None:
    end_s = time.monotonic() + LIMIT_S
    while not condition():
        assert time.monotonic() < end_s, "the condition was not met in time"
        time.sleep(0.005)


class CountingSource:
    """A sensor whose images are their numbers; it can be unplugged."""

    title = "counting"
    sensor = "digit"
    touching_object = None

    def __init__(self, *, every_s: float = 0.002, skip: int = 0) -> None:
        self.plugged = True
        self._every_s = every_s
        self._skip = skip
        self._n = 0

    def open(self) -> None:
        if not self.plugged:
            raise LiveSourceLost("it is not connected")

    def read(self) -> LiveFrame:
        if not self.plugged:
            raise LiveSourceLost("it was unplugged")
        time.sleep(self._every_s)
        number = self._n
        self._n = self._n + 1 + self._skip
        image = np.full((*DIGIT.camera.shape, 3), 100 + number % 2, np.uint8)
        return LiveFrame(image=image, time_s=time.monotonic(), sequence_number=number)

    def close(self) -> None:
        pass


class FixedSource(CountingSource):
    """A sensor whose image the test sets."""

    def __init__(self, image) -> None:
        super().__init__()
        self.image = image
        self.opened = 0

    def open(self) -> None:
        self.opened += 1

    def read(self) -> LiveFrame:
        return replace(super().read(), image=self.image)


@pytest.fixture
def running():
    readers: list[LiveReader] = []

    def start(source, **options) -> LiveReader:
        readers.append(LiveReader(source, **options))
        readers[-1].start()
        return readers[-1]

    yield start
    for live_reader in readers:
        assert live_reader.stop(LIMIT_S)


def test_a_simulated_sensor_gives_touches_with_truth_and_a_reference_without_contact(running):
    watched = running(SimulatedSource(sensor="digit", rate_hz=60.0))
    wait_until(lambda: watched.n_frames > 30)
    status = watched.status()
    assert status.state == "running"
    assert status.rate_hz > 0
    deepest = [
        float(watched.truth(i).indentation_mm.max())
        for i in range(watched._first_index, watched.n_frames)
    ]
    assert deepest[0] == 0.0
    assert max(deepest) > 0.1
    last = watched.frame(watched.n_frames - 1)
    assert last.image.shape == last.reference.shape == (*DIGIT.camera.shape, 3)
    recording = watched.make_recording(Path("live:/a"))
    assert recording.object_mesh.name
    assert recording.symmetry is not None
    still = watched.frame(watched._first_index)
    assert np.abs(still.image.astype(float) - last.reference).mean() < 3.0  # noise alone


def test_an_unplugged_sensor_is_reported_and_opened_again(running, monkeypatch):
    monkeypatch.setattr(reader, "RETRY_S", 0.01)
    source = CountingSource()
    watched = running(source)
    wait_until(lambda: watched.n_frames > 10)
    source.plugged = False
    wait_until(lambda: watched.status().state == "lost")
    before = watched.n_frames
    assert watched.status().rate_hz == 0.0
    assert watched.status().message in ("it is not connected", "it was unplugged")
    assert watched.frame(before - 1).index == before - 1  # still buffered
    source.plugged = True
    wait_until(lambda: watched.n_frames > before + 5)
    assert watched.status().state == "running"
    assert watched.status().message == ""


def test_lost_frames_are_counted_and_errors_of_a_driver_do_not_end_the_reader(running, monkeypatch):
    monkeypatch.setattr(reader, "RETRY_S", 0.01)
    source = CountingSource(skip=2)
    watched = running(source)
    wait_until(lambda: watched.n_frames > 10)
    assert watched.status().n_lost == pytest.approx(2 * (watched.n_frames - 1), abs=6)
    good_read = source.read
    source.read = lambda: 1 / 0
    wait_until(lambda: watched.status().state == "lost")
    assert "ZeroDivisionError" in watched.status().message
    source.read = good_read
    wait_until(lambda: watched.status().state == "running")


def test_memory_is_bounded_and_old_frames_are_refused(running):
    size = 3 * DIGIT.camera.rows * DIGIT.camera.cols
    watched = running(CountingSource(every_s=0.0005), max_bytes=30 * size)
    wait_until(lambda: watched.n_frames > 60)
    assert 0 < watched.n_frames - watched._first_index <= 31
    with pytest.raises(FileProblem, match="frame 0"):
        watched.frame(0)


def test_the_reference_is_the_median_of_the_last_frames_and_warns_of_motion_and_drift():
    rng = np.random.default_rng(0)
    still = [
        np.clip(rng.normal(120, 2, (*DIGIT.camera.shape, 3)), 0, 255).astype(np.uint8)
        for _ in range(15)
    ]
    reference = reference_capture.compute_median_image(still)
    assert np.abs(reference.astype(float) - 119.5).mean() < 0.7  # of a single image: 1.6
    assert reference_capture.check_motion(still, DIGIT) == ""
    touched = still[-1].copy()
    touched[100:200, 80:160] += 60
    assert reference_capture.check_motion([*still[:-1], touched], DIGIT)
    assert reference_capture.check_drift(touched, reference, DIGIT) == ""  # a touch is no drift
    assert "40.0 grey levels" in reference_capture.check_drift(reference + 40, reference, DIGIT)


def test_a_reference_with_an_object_on_the_gel_is_noticed(running):
    plain = np.full((*DIGIT.camera.shape, 3), 110, np.uint8)
    touched = plain.copy()
    touched[100:200, 80:160] += 60
    source = FixedSource(plain)
    watched = running(source)
    wait_until(lambda: watched.has_reference)
    assert watched.status().message == ""
    source.image = touched
    n = watched.n_frames
    wait_until(lambda: watched.n_frames > n + 2 * reference_capture.MAX_FRAMES)
    for _ in range(2):  # the warning stays when asked twice
        assert "touch" in watched.capture_reference()
    source.image = plain + 30  # the light of the room is no touch
    n = watched.n_frames
    wait_until(lambda: watched.n_frames > n + 2 * reference_capture.MAX_FRAMES)
    assert watched.capture_reference() == ""


def test_a_new_image_size_is_reported_and_gets_a_new_reference(running, tmp_path):
    source = FixedSource(np.full((*DIGIT.camera.shape, 3), 110, np.uint8))
    watched = running(source)
    recorder = LiveRecorder(tmp_path / "a.h5", watched)
    wait_until(lambda: watched.has_reference)
    wait_until(lambda: recorder.n_written > 2)
    source.image = np.full((120, 160, 3), 90, np.uint8)
    wait_until(lambda: bool(recorder.problem))
    assert recorder.close()
    wait_until(lambda: watched.frame(watched.n_frames - 1).reference is not None)
    newest = watched.frame(watched.n_frames - 1)
    assert newest.reference.shape == newest.image.shape == (120, 160, 3)
    assert watched.status().state == "running", "no driver failed"
    assert source.opened == 1
    reopened = open_recording(tmp_path / "a.h5")
    assert reopened.streams[0].n_frames == recorder.n_written
    reopened.close()


def test_a_depth_reference_has_gaps_only_where_most_frames_have_them():
    images = [np.full((4, 4), 90.0 + i, np.float32) for i in range(3)]
    images[0][0, 0] = np.nan
    for one in images[:2]:
        one[1, 1] = np.nan
    reference = reference_capture.compute_median_image(images)
    assert reference[0, 0] == pytest.approx(91.5)
    assert np.isnan(reference[1, 1])
    assert reference[2, 2] == 91.0


def test_a_folder_gives_the_newest_complete_image_and_counts_the_others(tmp_path):
    shape = (*DIGIT.camera.shape, 3)

    def write(name: str, grey: int, age_s: float) -> None:
        cv2.imwrite(str(tmp_path / name), np.full(shape, grey, np.uint8))
        os.utime(tmp_path / name, (time.time() - age_s,) * 2)

    write("before.png", 10, 100.0)
    source = FolderSource(tmp_path, sensor="digit")
    source.open()
    assert source.read() is None  # images from before are skipped
    for i in range(3):
        write(f"{i}.png", 50 + i, 3.0 - i)
    (tmp_path / "half.png").write_bytes((tmp_path / "2.png").read_bytes()[:500])
    newest = source.read()
    assert newest.image[0, 0].tolist() == [52, 52, 52]
    assert newest.sequence_number == 3
    shutil.copy(tmp_path / "0.png", tmp_path / "half.png")  # complete now
    assert source.read().image[0, 0].tolist() == [50, 50, 50]
    shutil.rmtree(tmp_path)
    with pytest.raises(LiveSourceLost, match="gone"):
        source.read()


def test_a_folder_without_news_is_not_listed_again(tmp_path, monkeypatch):
    """Or 50,000 images would cost a quarter of a processor core while nothing comes."""
    source = FolderSource(tmp_path, sensor="digit")
    listed = []
    scan = os.scandir
    monkeypatch.setattr(os, "scandir", lambda folder: listed.append(folder) or scan(folder))
    os.utime(tmp_path, (time.time() - 60.0,) * 2)
    source.open()
    assert source.read() is None
    assert len(listed) <= 2
    cv2.imwrite(str(tmp_path / "a.png"), np.full((*DIGIT.camera.shape, 3), 7, np.uint8))
    assert source.read().image[0, 0].tolist() == [7, 7, 7]


def test_a_camera_is_found_by_name_and_serial_number_and_never_by_its_metadata_node(tmp_path):
    for name in (
        "usb-Facebook_DIGIT_D20123-video-index0",
        "usb-Facebook_DIGIT_D20123-video-index1",
        "usb-Arducam_GelSight_Mini_R0B_28WZ-video-index0",
        "usb-HD_Webcam-video-index0",
    ):
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
    with pytest.raises(LiveSourceLost, match="D99999"):
        UsbCameraSource("D99999", by_id=tmp_path).open()


class _Stream:
    """The capture of OpenCV for a camera."""

    def __init__(self, bgr: np.ndarray) -> None:
        self._bgr = bgr

    def isOpened(self) -> bool:
        return True

    def read(self):
        return (self._bgr is not None), self._bgr

    def release(self) -> None:
        self._bgr = None


def test_a_digit_image_is_rotated_as_by_its_driver_and_the_end_of_its_stream_is_a_loss(tmp_path):
    bgr = np.full((240, 320, 3), (20, 40, 60), np.uint8)
    bgr[0, 0] = (255, 0, 0)  # blue, top left of the raw image
    stream = _Stream(bgr)
    source = UsbCameraSource("DIGIT", by_id=_node(tmp_path), opener=lambda node, kind: stream)
    source.open()
    image = source.read().image
    assert image.shape == (320, 240, 3)
    assert image[319, 0].tolist() == [0, 0, 255]
    stream.release()
    with pytest.raises(LiveSourceLost, match="DIGIT"):
        source.read()


def test_the_full_image_of_a_gelsight_mini_is_cropped_and_resized(tmp_path):
    stream = _Stream(np.full((2464, 3280, 3), 90, np.uint8))
    source = UsbCameraSource(
        "GelSight", by_id=_node(tmp_path, "GelSight_Mini_R0B"), opener=lambda node, kind: stream
    )
    source.open()
    assert source.read().image.shape == (*load_sensor("gelsight_mini").camera.shape, 3)
    assert source.sensor == "gelsight_mini"


def _node(folder: Path, name: str = "Facebook_DIGIT_D1") -> Path:
    (folder / f"usb-{name}-video-index0").touch()
    return folder


def test_a_video_file_is_read_as_a_camera(tmp_path, running, monkeypatch):
    monkeypatch.setattr(reader, "RETRY_S", 0.01)
    path = tmp_path / "stream.avi"
    size = (240, 320)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 30.0, size)
    for i in range(20):
        writer.write(np.full((320, 240, 3), 100 + i, np.uint8))
    writer.release()
    watched = running(UsbCameraSource(str(path), sensor="gelsight_mini"))
    wait_until(lambda: watched.n_frames > 30)  # the video ended once and was opened again
    assert watched.frame(watched.n_frames - 1).image.shape == (
        *load_sensor("gelsight_mini").camera.shape,
        3,
    )


def test_a_live_sensor_opens_as_a_recording_that_grows(running):
    watched = running(CountingSource())
    path = Path("live:/counted")
    wait_until(lambda: watched.n_frames > 20)
    mounts.mount(path, lambda: watched.make_recording(path))
    try:
        recording = open_recording(path)
        n = recording.streams[0].n_frames
        wait_until(lambda: watched.n_frames > n)
        assert recording.refresh().streams[0].n_frames > n
        assert recording.streams[0].frame(n - 1).index == n - 1
    finally:
        mounts.unmount(path)
    with pytest.raises(FileProblem, match="no such file"):
        open_recording(path)


def test_a_recording_can_be_read_while_it_grows_and_equals_the_live_frames(tmp_path, running):
    watched = running(SimulatedSource(sensor="digit", rate_hz=120.0))
    wait_until(lambda: watched.n_frames > 10)
    recorder = LiveRecorder(tmp_path / "a.h5", watched)
    wait_until(lambda: recorder.n_written > 5)
    meanwhile = hdf5.read(tmp_path / "a.h5")
    assert meanwhile.streams[0].n_frames > 0
    assert meanwhile.streams[0].frame(0).image.any()
    meanwhile.close()
    assert recorder.close()
    whole = hdf5.read(tmp_path / "a.h5")
    stream = whole.streams[0]
    assert stream.n_frames == recorder.n_written
    assert not any(hdf5.NOT_CLOSED_NOTE in note for note in whole.notes)
    first = stream.frame(0)
    buffered = next(
        watched.frame(i)
        for i in range(watched._first_index, watched.n_frames)
        if watched.frame(i).time_s == first.time_s
    )
    assert np.array_equal(first.image, buffered.image)
    assert np.array_equal(first.reference, buffered.reference)
    whole.close()


class NumberedSource(CountingSource):
    """240 images of 640 x 480 px at 60 Hz, the first pixel of each its number."""

    def __init__(self) -> None:
        super().__init__()
        rng = np.random.default_rng(0)
        self._image = rng.normal(120.0, 2.0, (640, 480, 3)).astype(np.uint8)

    def read(self) -> LiveFrame | None:
        if self._n == 240:
            time.sleep(0.01)
            return None
        time.sleep(1 / 60)
        image = self._image.copy()
        image[0, 0, 0] = self._n
        self._n += 1
        return LiveFrame(image=image, time_s=time.monotonic(), sequence_number=self._n)


def test_a_recording_at_60_hz_lacks_no_number(tmp_path, running, monkeypatch):
    """Not even where a slow disk leaves frames waiting, which are then written uncompressed."""
    monkeypatch.setattr(live_recorder, "_BEHIND_FRAMES", 1)
    watched = LiveReader(NumberedSource())
    recorder = LiveRecorder(tmp_path / "a.h5", watched)
    watched.start()
    wait_until(lambda: watched.n_frames == 240)
    assert watched.stop(LIMIT_S)
    assert recorder.close(LIMIT_S)
    assert not recorder.n_dropped
    with closing(hdf5.read(tmp_path / "a.h5")) as recording:
        stream = recording.streams[0]
        numbers = [int(stream.frame(k).image[0, 0, 0]) for k in range(stream.n_frames)]
        frames = h5py.File(tmp_path / "a.h5")["streams/digit/frames"]
        bytes_of = {frames.id.get_chunk_info(k).size for k in range(frames.id.get_num_chunks())}
    assert numbers == list(range(numbers[0], 240))
    assert numbers[0] < 20, "all but those before the reference"
    assert max(bytes_of) == 640 * 480 * 3 + 4, "some are stored as they are, with a checksum"


@pytest.mark.parametrize("effort", ["little", "none"])
def test_a_noisy_image_packed_in_a_hurry_reads_the_same_and_is_no_larger(tmp_path, effort):
    image = np.random.default_rng(0).normal(120.0, 2.0, (64, 48, 3)).astype(np.uint8)
    frame = TactileFrame(sensor="digit", image=image, reference=None)
    with hdf5_writer.RecordingWriter(tmp_path / "a.h5", coding="row differences") as writer:
        writer.append("digit", frame)
        writer.append("digit", frame, effort=effort)
    with closing(hdf5.read(tmp_path / "a.h5")) as recording:
        np.testing.assert_array_equal(recording.streams[0].frame(1).image, image)
    with h5py.File(tmp_path / "a.h5") as file:
        frames = file["streams/digit/frames"]
        sizes = [frames.id.get_chunk_info(k).size for k in range(2)]
    assert sizes[1] < sizes[0] if effort == "little" else sizes[1] == image.nbytes + 4


@pytest.mark.parametrize("n_bytes", [1, 2, 5, 719, 720, 100_001])
@pytest.mark.parametrize("fill", [0, 255, None])
def test_an_uncompressed_row_has_the_checksum_that_hdf5_writes(tmp_path, n_bytes, fill):
    row = np.random.default_rng(n_bytes).integers(0, 256, n_bytes, dtype=np.uint8)
    row = row if fill is None else np.full_like(row, fill)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        options = {"chunks": (1, n_bytes), "dtype": np.uint8, "fletcher32": True}
        rows = file.create_dataset("rows", (1, n_bytes), **options)
        rows[0] = row
        stored = rows.id.read_direct_chunk((0, 0))[1]
    assert stored[-4:] == hdf5_writer._compute_fletcher32(row.tobytes()).to_bytes(4, "little")


def test_a_recording_survives_a_kill_at_any_moment(tmp_path):
    path = tmp_path / "killed.h5"
    before = 0
    command = [SCRIPT, "live", "--sensor", "digit", "--rate", "60", "--record", path]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as other:
        for line in other.stdout:
            if " recorded" in line and int(line.split(" recorded")[0].split()[-1]) > 10:
                with closing(hdf5.read(path)) as growing:
                    before = growing.streams[0].n_frames
            if before > 5:
                break
        other.send_signal(signal.SIGKILL)
    recording = open_recording(path)
    stream = recording.streams[0]
    assert any(hdf5.NOT_CLOSED_NOTE in note for note in recording.notes)
    assert stream.n_frames >= before > 5
    for index in range(stream.n_frames):
        assert stream.frame(index).image.shape == (*DIGIT.camera.shape, 3)
        assert stream.truth(index).indentation_mm is not None
    recording.close()
    assert run_app(build_app(), ["inspect", str(path)]) == 0


def limit_disk(monkeypatch: pytest.MonkeyPatch, n_bytes: int) -> None:
    """Let files grow to `n_bytes` at most, as on a full disk."""
    allocate = os.posix_fallocate

    def allocate_within(descriptor: int, offset: int, length: int) -> None:
        if length > n_bytes:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        allocate(descriptor, offset, length)

    monkeypatch.setattr(os, "posix_fallocate", allocate_within)


def test_a_full_disk_is_reported_and_the_frames_so_far_stay(tmp_path, running, monkeypatch, capsys):
    watched = running(SimulatedSource(sensor="digit", rate_hz=120.0))
    wait_until(lambda: watched.n_frames > 10)
    limit_disk(monkeypatch, 4 << 20)
    path = tmp_path / "a.h5"
    recorder = LiveRecorder(path, watched)
    wait_until(lambda: bool(recorder.problem))
    assert recorder.close()
    assert "No space left on device" in recorder.problem
    reopened = open_recording(path)
    assert reopened.streams[0].n_frames == recorder.n_written > 0
    assert reopened.streams[0].frame(recorder.n_written - 1).image.any()
    reopened.close()

    limit_disk(monkeypatch, 0)
    assert run_app(build_app(), ["live", "--record", str(tmp_path / "b.h5"), "--seconds", "2"]) == 2
    assert "No space left on device" in capsys.readouterr().err
    assert not (tmp_path / "b.h5").exists()


def test_a_recording_without_frames_leaves_no_file(tmp_path):
    recorder = LiveRecorder(tmp_path / "a.h5", LiveReader(CountingSource()))
    assert recorder.close()
    assert recorder.n_written == 0
    assert not any(tmp_path.iterdir())


def test_the_live_command_prints_state_and_rate(capsys, tmp_path):
    for seconds in ("2.5", "20", "120"):  # a busy machine takes longer to begin
        run_app(
            build_app(),
            ["live", "--source", "simulated", "--sensor", "digit", "--seconds", seconds],
        )
        if "running: " in (output := capsys.readouterr().out):
            break
    assert "running: " in output
    assert " Hz, " in output
    assert (
        run_app(
            build_app(), ["live", "--source", "folder", str(tmp_path / "none"), "--seconds", "1.2"]
        )
        == 1
    )
    assert "there is no folder" in capsys.readouterr().out
    assert run_app(build_app(), ["live", "--list"]) == 0


@pytest.mark.parametrize("words", [("nothing",), ("folder",), ("device", "a", "b")])
def test_words_that_are_no_source_are_refused(words):
    from pipeline.io.live.source_parsing import parse_source

    with pytest.raises(SettingProblem, match=re.escape(repr(" ".join(words)))):
        parse_source(words)


def test_the_leds_of_a_digit_have_full_intensity():
    assert (
        next(kind for kind in usb_camera.USB_CAMERA_PROFILES if kind.sensor == "digit").led_setting
        == 0xFFF
    )


def test_too_few_frames_to_record_exit_with_one(tmp_path, capsys):
    words = [
        "live",
        "--sensor",
        "digit",
        "--rate",
        "3",
        "--record",
        str(tmp_path / "a.h5"),
        "--seconds",
        "1.5",
    ]
    assert run_app(build_app(), words) == 1
    assert "first 7" in capsys.readouterr().out
    assert not (tmp_path / "a.h5").exists()


@pytest.mark.parametrize("words", [["folder", "a b/c"], ["folder a b/c"]])
def test_a_quoted_source_equals_separate_words(words):
    from pipeline.io.live.source_parsing import parse_source

    source = parse_source(words, sensor="digit")
    assert isinstance(source, FolderSource)
    with pytest.raises(LiveSourceLost, match="a b/c"):
        source.open()


def test_the_result_says_how_many_frames_were_left_out(capsys, tmp_path):
    from types import SimpleNamespace

    from pipeline.cli import live

    reader = SimpleNamespace(
        status=lambda: ReaderStatus(state="stopped", n_frames=21_920, rate_hz=0.0, n_lost=0)
    )
    recorder = SimpleNamespace(n_written=6_293, n_dropped=0, problem="", path=tmp_path / "a.h5")
    assert live._print_result(reader, recorder) == 0
    assert "6293 of 21920 frames in" in (said := capsys.readouterr().out)
    assert "15627 left out" in said


@pytest.mark.parametrize(
    ("numbers", "lost"),
    [((0, 1, 2), 0), ((0, 2, 3), 1), ((5, 6, 9), 2), ((3, 3, 4), 0), ((9, 0, 1), 0)],
)
def test_every_lost_frame_is_counted_also_a_single_one(numbers, lost):
    source = CountingSource()
    now_s = time.monotonic()
    watched = LiveReader(source)
    image = np.zeros((*DIGIT.camera.shape, 3), np.uint8)
    for number in numbers:
        watched._add_frame(LiveFrame(image=image, time_s=now_s, sequence_number=number))
    assert watched.status().n_lost == lost
