"""Folders in which a gel's images lie next to what was derived from them."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from pipeline.core.errors import MissingReference, UnknownSensor
from pipeline.io import open_recording
from pipeline.translation.translate import Request, open_translation

SHAPE = (68, 90)
N_TOUCHES = 3


def write(path: Path, *colour: int) -> None:
    assert cv2.imwrite(
        str(path), np.full((*SHAPE, len(colour)) if len(colour) > 1 else SHAPE, colour, np.uint8)
    )


@pytest.fixture
def clip(tmp_path: Path) -> Path:
    for i in range(N_TOUCHES):
        write(tmp_path / f"touch_{i:03d}.png", 10, 60, 120 + i)
        write(tmp_path / f"lab_depth_{i:03d}.png", 200)
    return tmp_path


def test_grey_images_next_to_colour_ones_are_left_out(clip: Path):
    recording = open_recording(clip, sensor="gelslim")
    assert [
        recording.streams[0].frame(i).origin[-13:] for i in range(recording.streams[0].n_frames)
    ] == [f"touch_{i:03d}.png" for i in range(N_TOUCHES)]
    assert any(
        note.startswith("3 grey images such as lab_depth_000.png are left out")
        for note in recording.notes
    )


def test_grey_images_alone_stay(tmp_path: Path):
    for name in ("touch_1", "mask_1"):
        write(tmp_path / f"{name}.png", 100)
    assert open_recording(tmp_path, sensor="gelslim").streams[0].n_frames == 2


def test_the_sensor_is_the_one_that_all_file_names_hold(tmp_path: Path):
    for i in range(N_TOUCHES):
        write(tmp_path / f"{i}_pattern_gelslim.png", 10, 60, 120)
        write(tmp_path / f"{i}_pattern_bubble_gt.png", 90)
    recording = open_recording(tmp_path)
    assert (recording.streams[0].sensor, recording.streams[0].n_frames) == ("gelslim", N_TOUCHES)
    partner = recording.streams[1]  # a picture of the same touch, and no measurement of a bubble
    assert (partner.name, partner.sensor, partner.n_frames) == ("bubble_gt", "", N_TOUCHES)
    assert partner.frame(1).origin.endswith("1_pattern_bubble_gt.png")
    assert partner.frame(1).image[0, 0].tolist() == [90, 90, 90]
    assert not any("left out" in note for note in recording.notes)
    write(tmp_path / "9_pattern.png", 10, 60, 120)
    assert open_recording(tmp_path).streams[0].sensor == ""


def test_an_unknown_sensor_names_the_other_recordings_of_the_folder(tmp_path: Path):
    for name in ("left", "right"):
        (tmp_path / name).mkdir()
        for i in range(2):
            write(tmp_path / name / f"touch_{i}.png", 10, 60, 120)
    with pytest.raises(UnknownSensor, match="choose one") as caught:
        open_translation(Request(recording=tmp_path, target="soft_bubble"))
    assert caught.value.alternatives == (tmp_path / "left", tmp_path / "right")
    assert open_recording(tmp_path).alternatives == (tmp_path / "left", tmp_path / "right")
    with pytest.raises(UnknownSensor) as caught:
        open_translation(Request(recording=tmp_path / "left", target="soft_bubble"))
    assert caught.value.alternatives == ()


def test_a_sequence_that_begins_with_frames_alike_has_their_median_as_reference(clip: Path):
    frame = open_recording(clip, sensor="gelslim").streams[0].frame(2)
    assert frame.reference is not None
    assert frame.reference[0, 0].tolist() == [121, 60, 10]


def test_a_frame_without_reference_says_so_by_its_own_error(tmp_path: Path):
    for i in range(N_TOUCHES):
        write(tmp_path / f"touch_{i}.png", 10, 60, 60 + 60 * i)
    translation = open_translation(
        Request(recording=tmp_path, source="gelslim", target="soft_bubble")
    )
    with pytest.raises(MissingReference):
        _ = translation[0].depth
    translation.recording.close()
