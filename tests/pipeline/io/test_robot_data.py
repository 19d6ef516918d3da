"""Robot-learning data sets, and files that are refused by name."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import cv2
import h5py
import numpy as np
import pytest

from pipeline.core.errors import FileProblem, SettingProblem
from pipeline.io import open_recording


def test_robomimic_demonstrations_follow_each_other(tmp_path: Path, touches):
    with h5py.File(tmp_path / "a.hdf5", "w") as file:
        for demo in (0, 1, 2, 10):
            observed = file.create_group(f"data/demo_{demo}/obs")
            observed["tactile_left"] = touches.images[: demo + 4]
            observed["agentview_image"] = touches.images
            file[f"data/demo_{demo}/next_obs/tactile_left"] = touches.images
            file[f"data/demo_{demo}"].attrs["model_file"] = "x" * 30_000
    recording = open_recording(tmp_path / "a.hdf5")
    (stream,) = recording.streams
    assert stream.n_frames == 4 + 5 + 6 + 14
    # demo_10 is the last
    assert np.array_equal(stream.frame(4 + 5 + 6 + 13).image, touches.images[13])
    assert any("agentview_image" in note for note in recording.notes)
    recording.close()


@pytest.mark.parametrize("how", ["plain", "padded", "varying"])
def test_cameras_of_act_are_read_plain_and_encoded(tmp_path: Path, touches, how: str):
    encoded = [
        cv2.imencode(".png", np.ascontiguousarray(image[..., ::-1]))[1].ravel()
        for image in touches.images
    ]
    with h5py.File(tmp_path / "episode_0.hdf5", "w") as file:
        place = file.create_group("observations/images")
        if how == "plain":
            place.create_dataset(
                "gelsight", data=touches.images, chunks=(1, *touches.images.shape[1:])
            )
        elif how == "padded":
            longest = max(map(len, encoded))
            place["gelsight"] = np.stack([np.pad(row, (0, longest - len(row))) for row in encoded])
        else:
            rows = place.create_dataset("gelsight", (len(encoded),), h5py.vlen_dtype(np.uint8))
            for i, row in enumerate(encoded):
                rows[i] = row
        file["action"] = np.zeros((len(encoded), 7))
    (stream,) = open_recording(tmp_path / "episode_0.hdf5").streams
    assert np.array_equal(stream.frame(8).image, touches.images[8])


def test_cameras_that_name_no_touch_are_not_guessed_among(tmp_path: Path, touches):
    with h5py.File(tmp_path / "a.hdf5", "w") as file:
        file["observations/images/front"] = file["observations/images/wrist"] = touches.images
    recording = open_recording(tmp_path / "a.hdf5")
    assert [stream.sensor for stream in recording.streams] == ["", ""]
    assert any("say which with --stream wrist --sensor" in note for note in recording.notes)
    recording = open_recording(tmp_path / "a.hdf5", stream="wrist", sensor="gelslim")
    assert {stream.name: stream.sensor for stream in recording.streams} == {
        "front": "",
        "wrist": "gelslim",
    }


def test_a_reference_is_of_the_camera_that_the_user_names(tmp_path: Path, touches):
    with h5py.File(tmp_path / "a.hdf5", "w") as file:
        for camera in ("tactile_left", "tactile_right"):
            file[f"data/demo_0/obs/{camera}"] = touches.images
    assert cv2.imwrite(str(tmp_path / "r.png"), np.full_like(touches.images[0], 77))
    with pytest.raises(
        SettingProblem, match=r"choose it with --stream \(tactile_left, tactile_right\)"
    ):
        open_recording(tmp_path / "a.hdf5", reference=tmp_path / "r.png")
    recording = open_recording(
        tmp_path / "a.hdf5", reference=tmp_path / "r.png", stream="tactile_right"
    )
    assert (recording.stream("tactile_right").frame(0).reference == 77).all()
    assert not (recording.stream("tactile_left").frame(0).reference == 77).all()


def test_an_hdf5_file_that_points_outside_itself_shows_nothing_of_it(tmp_path: Path, touches):
    with h5py.File(tmp_path / "secret.hdf5", "w") as file:
        file["tactile"] = touches.images
    with h5py.File(tmp_path / "a.hdf5", "w") as file:
        file["tactile"] = h5py.ExternalLink(str(tmp_path / "secret.hdf5"), "tactile")
    with pytest.raises(FileProblem, match="no colour images"):
        open_recording(tmp_path / "a.hdf5")


def test_a_zarr_store_is_refused_by_name(tmp_path: Path):
    (tmp_path / ".zgroup").write_text('{"zarr_format": 2}')
    (tmp_path / "data" / "tactile_img").mkdir(parents=True)
    with pytest.raises(FileProblem, match=r"a Zarr store is not read; .* zarr.open\(FOLDER\)"):
        open_recording(tmp_path)


@pytest.mark.parametrize(
    ("name", "content", "why"),
    [
        ("a.bag", b"#ROSBAG V2.0\n" + bytes(99), "ROS 1 bag.*mcap convert"),
        ("a.db3", None, "ROS 2 bag.*mcap convert"),
        ("a.mat", b"MATLAB 5.0 MAT-file" + bytes(99), "MATLAB.*numpy"),
        ("a.zip", b"PK\x03\x04" + bytes(99), "unpack it"),
        ("a.tfrecord-00000-of-00001", bytes(64), "TFRecords"),
        ("a.tar.gz", b"\x1f\x8b" + bytes(64), "unpack it"),
    ],
)
@pytest.mark.parametrize("in_folder", [False, True])
def test_known_kinds_that_are_not_read_are_refused_by_name(
    tmp_path: Path, name, content, why, in_folder: bool
):
    if content is None:
        with sqlite3.connect(tmp_path / name) as database:
            database.execute("create table topics(id integer)")
    else:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(FileProblem, match=why):
        open_recording(tmp_path if in_folder else tmp_path / name)


def test_a_folder_with_tactile_images_and_depth_opens_the_first_and_names_the_other(
    tmp_path: Path, touches
):
    for i, image in enumerate(touches.images):
        for name, pixels in (
            ("tactile", image[..., ::-1]),
            ("depth", image[..., 0].astype(np.uint16) * 20),
        ):
            (tmp_path / name).mkdir(exist_ok=True)
            cv2.imwrite(str(tmp_path / name / f"{i}.png"), np.ascontiguousarray(pixels))
    recording = open_recording(tmp_path)
    assert np.array_equal(recording.streams[0].frame(8).image, touches.images[8])
    assert any("depth" in note for note in recording.notes)
    (tmp_path / "tactile").rename(tmp_path / "rgb")
    with pytest.raises(FileProblem, match="or open rgb of the same folder"):
        open_recording(tmp_path)
    assert open_recording(tmp_path / "rgb").streams[0].sensor == "gelslim"
