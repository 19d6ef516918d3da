"""Folders of images, single images and videos."""

from __future__ import annotations

import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from pipeline.core.errors import FileProblem, SettingProblem, ShapeError
from pipeline.io import open_recording
from pipeline.io.sensor_guess import resolve_sensor_name

RED = (200, 30, 10)
VIDEO_GREY = 12  # grey levels that a lossy video codec may change in a flat colour


def save(path: Path, rgb=RED, shape=(240, 320)) -> Path:
    image = np.zeros((*shape, 3), np.uint8) + np.array(rgb[::-1], np.uint8)
    assert cv2.imwrite(str(path), image)
    return path


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, red in (("background", 1), ("press_10", 110), ("press_2", 102), ("press_1", 101)):
        save(tmp_path / f"{name}.png", (red, 30, 10))
    return tmp_path


def test_frames_come_in_natural_order_with_the_background_as_reference(folder: Path):
    recording = open_recording(folder)
    (stream,) = recording.streams
    assert [int(stream.frame(i).image[0, 0, 0]) for i in range(stream.n_frames)] == [101, 102, 110]
    assert stream.frame(0).reference[0, 0].tolist() == [1, 30, 10]  # red first
    assert stream.sensor == "gelsight_mini"
    assert "background.png is the reference" in recording.notes


@pytest.mark.parametrize(
    ("shape", "sensor"),
    [((320, 427), "gelslim"), ((320, 240), "digit"), ((240, 320), "gelsight_mini")],
)
def test_the_sensor_is_guessed_from_the_size_with_a_note(tmp_path: Path, shape, sensor: str):
    save(tmp_path / "a.png", shape=shape)
    recording = open_recording(tmp_path)
    assert recording.streams[0].sensor == recording.streams[0].frame(0).sensor == sensor
    assert any("does not name its sensor" in note for note in recording.notes)


def test_a_size_that_fits_no_sensor_asks_for_its_name(tmp_path: Path):
    save(tmp_path / "a.png", shape=(50, 60))
    recording = open_recording(tmp_path)
    assert recording.streams[0].sensor == ""
    assert any("say which with --sensor" in note for note in recording.notes)
    assert open_recording(tmp_path, sensor="digit").streams[0].sensor == "digit"


def test_an_unknown_sensor_is_refused(folder: Path):
    with pytest.raises(SettingProblem, match="unknown sensor 'nose'"):
        open_recording(folder, sensor="nose")


def test_a_stated_reference_is_used_and_is_no_frame(folder: Path):
    recording = open_recording(folder, reference=folder / "press_2.png")
    assert recording.streams[0].n_frames == 2
    assert recording.streams[0].frame(0).reference[0, 0, 0] == 102


def test_without_a_reference_the_notes_say_so(tmp_path: Path):
    save(tmp_path / "press.png")
    recording = open_recording(tmp_path)
    assert recording.streams[0].frame(0).reference is None
    assert any("no reference image" in note for note in recording.notes)


def test_a_missing_reference_is_named(folder: Path):
    with pytest.raises(FileProblem, match=r"cannot read the reference image.*nowhere\.png"):
        open_recording(folder, reference=folder / "nowhere.png")


@pytest.mark.parametrize("damage", ["cut.png", "cut.jpg", "text.png", "empty.png"])
def test_one_damaged_image_is_named_and_the_others_are_read(folder: Path, damage: str):
    bad = folder / f"a_{damage}"
    if damage.startswith("cut"):
        noise = np.random.default_rng(0).integers(0, 255, (240, 320, 3), dtype=np.uint8)
        cv2.imwrite(str(bad), noise)
        bad.write_bytes(bad.read_bytes()[:3000])
    else:
        bad.write_bytes(b"" if damage.startswith("empty") else b"not an image at all")
    stream = open_recording(folder).streams[0]
    with pytest.raises(FileProblem, match=damage):
        stream.frame(0)
    assert stream.frame(1).image[0, 0, 0] == 101


def test_an_image_of_another_size_is_named(folder: Path):
    save(folder / "a_small.png", shape=(20, 30))
    with pytest.raises(
        FileProblem, match=r"frame 0 is 30 x 20 px, the others are 320 x 240 px.*a_small\.png"
    ):
        open_recording(folder).streams[0].frame(0)


def test_link_loops_pipes_and_odd_names_in_a_folder_are_skipped(folder: Path):
    (folder / "a_loop.png").symlink_to(folder / "a_loop.png")
    os.mkfifo(folder / "a_pipe.png")
    name = os.fsdecode(b"b\xff\xb2.png")
    save(folder / "b.png")
    (folder / "b.png").rename(folder / name)
    save(folder / "\u00b2.png")
    stream = open_recording(folder).streams[0]
    names = [Path(stream.frame(i).origin).name for i in range(2, stream.n_frames)]
    assert name in names
    for index in (0, 1):
        with pytest.raises(
            FileProblem, match=r"cannot read the image \((Too many levels|this is a pipe)"
        ):
            stream.frame(index)


def test_an_empty_folder_and_one_without_images_are_refused(tmp_path: Path):
    with pytest.raises(FileProblem, match="the folder is empty"):
        open_recording(tmp_path)
    (tmp_path / "notes.txt").write_text("nothing")
    with pytest.raises(FileProblem, match="the folder has no images"):
        open_recording(tmp_path)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.h5", b"nothing of the kind", "HDF5 file cannot be opened"),
        ("a.h5", b"", "the file is empty"),
        ("a.pkl", b"\x80\x04.", "a pickle can run code"),
        ("a.xyz", b"hello", "unknown kind of recording"),
        ("a.mp4", b"hello", "the video cannot be opened"),
    ],
)
def test_files_that_are_no_recordings_are_refused(
    tmp_path: Path, name: str, content: bytes, message: str
):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(FileProblem, match=message):
        open_recording(tmp_path / name)


def test_a_missing_file_is_named(tmp_path: Path):
    with pytest.raises(FileProblem, match=r"no such file or folder.*nowhere\.h5"):
        open_recording(tmp_path / "nowhere.h5")


def test_grey_and_transparent_images_become_rgb(tmp_path: Path):
    cv2.imwrite(str(tmp_path / "a.png"), np.full((240, 320), 77, np.uint8))
    cv2.imwrite(str(tmp_path / "b.png"), np.full((240, 320, 4), (10, 30, 200, 0), np.uint8))
    stream = open_recording(tmp_path).streams[0]
    assert stream.frame(0).image[5, 5].tolist() == [77, 77, 77]
    assert stream.frame(1).image[5, 5].tolist() == [200, 30, 10]


@pytest.fixture
def film(tmp_path: Path) -> Path:
    path = tmp_path / "film.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 20.0, (320, 240))
    for index in range(6):
        writer.write(np.full((240, 320, 3), (10, 30, 40 * index), np.uint8))
    writer.release()
    return path


def test_a_video_is_read_in_any_order_with_its_first_frame_as_reference(film: Path):
    recording = open_recording(film)
    stream = recording.streams[0]
    assert stream.n_frames == 6
    for index in (4, 5, 1, 2, 0):
        frame = stream.frame(index)
        np.testing.assert_allclose(frame.image[100, 100], [40 * index, 30, 10], atol=VIDEO_GREY)
        assert frame.time_s == pytest.approx(index / 20.0)
    np.testing.assert_array_equal(stream.frame(3).reference, stream.frame(0).image)
    assert any("first frame is taken as the reference" in note for note in recording.notes)
    recording.close()


def test_a_reference_of_another_size_is_refused(film: Path, tmp_path: Path):
    with pytest.raises((FileProblem, ShapeError), match=r"20 x 10 px.*ref\.png"):
        open_recording(film, reference=save(tmp_path / "ref.png", shape=(10, 20)))


@pytest.mark.parametrize(
    ("name", "n_frames", "sensor"),
    [
        ("gelslim3_balls", 39, "gelslim"),
        ("digit_balls", 42, "digit"),
        ("gsmini_balls", 67, "gelsight_mini"),
    ],
)
def test_real_folders_open_with_their_reference(
    real_data: Path, name: str, n_frames: int, sensor: str
):
    stream = open_recording(real_data / name).streams[0]
    assert (stream.n_frames, stream.sensor) == (n_frames, sensor)
    assert stream.frame(0).reference is not None


def test_a_reference_of_another_size_is_named_in_the_error(folder: Path):
    save(folder / "background.png", shape=(480, 640))
    with pytest.raises(
        FileProblem,
        match=r"reference image is 640 x 480 px, the others are 320 x 240 px.*background",
    ):
        open_recording(folder)
    save(folder / "press_1.png", shape=(480, 640))
    assert open_recording(folder).streams[0].frame(0).image.shape == (480, 640, 3), (
        "then one frame fits, others do not"
    )


def test_the_longest_sensor_name_in_the_names_of_the_files_is_taken():
    names = ["gelslim_dotless_01.png", "gelslim_dotless_02.png"]
    assert (
        resolve_sensor_name("", (111, 99), is_depth=False, file_names=names)[0] == "gelslim_dotless"
    )
    assert (
        resolve_sensor_name("", (111, 99), is_depth=False, file_names=[*names, "gelslim_3.png"])[0]
        == "gelslim"
    )
    assert resolve_sensor_name("", (111, 99), is_depth=False, file_names=["mygelslim.png"])[0] == ""
