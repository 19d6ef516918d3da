"""Folders as people have them: one file and a read-me, or a data set's own tree."""

from __future__ import annotations

import pickle
from pathlib import Path

import cv2
import h5py
import numpy as np
import pytest

from pipeline.core.errors import FileProblem
from pipeline.io import open_recording


def picture(path: Path, red: int = 100, shape=(240, 320)) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), np.full((*shape, 3), (10, 30, red), np.uint8))
    return path


def reds(recording) -> list[int]:
    stream = recording.streams[0]
    return [int(np.median(stream.frame(k).image[..., 0])) for k in range(stream.n_frames)]


def test_a_folder_with_one_recording_and_a_read_me_opens(tmp_path: Path):
    np.savez(tmp_path / "touches.npz", depth_mm=np.full((6, 14, 17), 80.0))
    (tmp_path / "README.md").write_text("pressed by hand")
    recording = open_recording(tmp_path)
    assert recording.streams[0].n_frames == 6
    assert any("one recording is touches.npz" in note for note in recording.notes)


def test_of_several_recordings_the_first_opens_and_the_others_are_named(tmp_path: Path):
    for k in (10, 2):
        np.savez(tmp_path / f"touch_{k}.npz", depth_mm=np.full((k, 14, 17), 80.0))
    recording = open_recording(tmp_path)
    assert recording.streams[0].n_frames == 2
    assert any(
        "touch_2.npz is opened" in note and "touch_10.npz" in note for note in recording.notes
    )


def test_a_folder_that_cannot_be_read_hides_none_beside_it(tmp_path: Path, monkeypatch):
    for name in ("a", "digit", "z"):
        (tmp_path / name).mkdir()
        np.savez(tmp_path / name / "touches.npz", depth_mm=np.full((6, 14, 17), 80.0))
    listed = Path.iterdir

    def refuse_one(folder: Path):
        if folder.name == "digit":
            raise PermissionError(13, "Permission denied")
        return listed(folder)

    monkeypatch.setattr(Path, "iterdir", refuse_one)
    recording = open_recording(tmp_path)
    assert recording.streams[0].n_frames == 6
    assert [path.name for path in recording.alternatives] == ["a", "z", "digit"]
    with pytest.raises(FileProblem, match="Permission denied"):
        open_recording(tmp_path / "digit")


@pytest.fixture
def slide(tmp_path: Path) -> Path:
    """YCB-Slide: frames next to a film, webcam images, drawings and pickles."""
    for number in (0, 1):
        data = tmp_path / "real" / "035_power_drill" / f"dataset_{number}"
        for k in range(3):
            picture(
                data / "frames" / f"frame_{k:07d}.jpg", red=100 + 20 * k + number, shape=(320, 240)
            )
            picture(data / "webcam_frames" / f"frame_{k:07d}.jpg", shape=(60, 80))
        picture(data / "tactile_data.png", shape=(30, 40))
        (data / "frames.mp4").write_bytes(b"film")
        np.save(data / "synced_data.npy", np.array({"poses": 1}, dtype=object), allow_pickle=True)
    np.save(data.parent / "alignment.npy", np.eye(4))
    picture(data.parent / "tactile_data.png", shape=(30, 40))
    return tmp_path


@pytest.mark.parametrize(
    "below", ["", "real", "real/035_power_drill", "real/035_power_drill/dataset_0"]
)
def test_the_tree_of_ycb_slide_opens_at_any_level(slide: Path, below: str):
    recording = open_recording(slide / below)
    assert recording.streams[0].sensor == "digit"
    np.testing.assert_allclose(reds(recording), [100, 120, 140], atol=2)
    assert any("other files there are left out" in note for note in recording.notes)


def test_a_simulated_slide_opens_its_tactile_images(tmp_path: Path):
    for name in ("gt_contactmasks", "gt_heightmaps", "tactile_images"):
        picture(tmp_path / "sim" / "004_sugar_box" / "00" / name / "0.jpg", shape=(320, 240))
    (tmp_path / "sim" / "004_sugar_box" / "00" / "tactile_data.pkl").write_bytes(b"\x80\x04.")
    assert "tactile_images" in open_recording(tmp_path / "sim").streams[0].frame(0).origin


@pytest.mark.parametrize("below", ["", "6.310mm"])
def test_a_calibration_with_each_press_in_its_own_folder_is_one_recording(
    tmp_path: Path, below: str
):
    picture(tmp_path / "background.png", red=5)
    for k in (0, 1, 2, 10):
        picture(tmp_path / "6.310mm" / str(k) / "gelsight.png", red=100 + k)
    recording = open_recording(tmp_path / below)
    assert reds(recording) == [100, 101, 102, 110]
    assert recording.streams[0].frame(0).reference[0, 0, 0] == 5


def test_reference_images_of_sparsh_are_found_in_the_folder_bgs(tmp_path: Path):
    for k in range(3):
        picture(tmp_path / "bgs" / f"bg_{k}.jpg", red=50 + k)
        picture(tmp_path / "can" / f"{k}.jpg", red=100)
    for place in (tmp_path, tmp_path / "can"):
        recording = open_recording(place)
        assert recording.streams[0].n_frames == 3
        assert recording.streams[0].frame(0).reference[0, 0].tolist() == pytest.approx(
            [50, 30, 10], abs=2
        )


def test_a_folder_of_pickles_is_refused_with_advice(tmp_path: Path):
    (tmp_path / "dataset_0.pkl").write_bytes(pickle.dumps([b"jpeg"]))
    for place in (tmp_path, tmp_path / "dataset_0.pkl"):
        with pytest.raises(
            FileProblem, match=r"can run code.*refused.*save the images as PNG.*numpy\.savez"
        ):
            open_recording(place)


def test_pickled_objects_in_an_array_file_are_named(tmp_path: Path):
    np.save(tmp_path / "synced.npy", np.array({"poses": 1}, dtype=object), allow_pickle=True)
    with pytest.raises(FileProblem, match=r"could run code.*numpy\.savez"):
        open_recording(tmp_path / "synced.npy")


def test_a_folder_of_tactoscope_recordings_opens(tmp_path: Path):
    from pipeline.core.values.frames import TactileFrame
    from pipeline.io.hdf5_writer import RecordingWriter

    image = np.full((320, 240, 3), 90, np.uint8)
    for name in ("ball.h5", "cube.h5"):
        with RecordingWriter(tmp_path / name) as writer:
            writer.append("digit", TactileFrame(sensor="digit", image=image, reference=None))
    recording = open_recording(tmp_path)
    assert recording.path.name == "ball.h5"
    assert h5py.is_hdf5(recording.path)
    recording.close()
