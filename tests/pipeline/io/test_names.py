"""Order, times and sensors of images, as their names tell."""

from __future__ import annotations

import os
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.core.errors import FileProblem, SettingProblem
from pipeline.core.values.pairing import NO_PARTNER, pair_frames
from pipeline.io import open_recording
from pipeline.io.file_names import parse_times_s, sort_series, split_sensors

START_S = 1744664892.05


def save(path: Path, rgb: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), np.ascontiguousarray(rgb[..., ::-1]))


def names_of(*stems: object) -> list[Path]:
    return [Path(f"{stem}.png") for stem in stems]


@given(st.lists(st.integers(0, 10**7), min_size=2, max_size=30, unique=True))
def test_times_as_python_prints_them_are_in_order_and_used(offsets_us: list[int]):
    times = sorted({round(START_S + us * 1e-6, 6) for us in offsets_us})
    files = names_of(*(repr(t) for t in times))
    assert sort_series(files[::-1]) == files
    if len(files) > 1:
        assert parse_times_s(files) == pytest.approx([t - times[0] for t in times], abs=1e-6)


@pytest.mark.parametrize(
    "stems",
    [
        ["f-1_0", "f-1_2", "f-1_10"],
        ["x_-10", "x_-2", "x_0", "x_3"],
        ["-1.5", "-1.25", "0.5"],
        ["z=-2.5", "z=-0.5", "z=1.0"],
        ["a_9", "a_10"],
        ["2025-01-02", "2025-01-10"],
        ["v1.2_frame_2", "v1.2_frame_10"],
        ["1.1", "1.2", "1.10"],
        ["1744664892", "1744664892.5", "1744664893"],
    ],
)
def test_the_order_of_numbers(stems: list[str]):
    assert [file.stem for file in sort_series(names_of(*reversed(stems)))] == stems


def test_file_times_tell_whether_a_point_is_a_decimal_point(tmp_path: Path):
    files = [tmp_path / f"{stem}.png" for stem in ("1.8", "1.9", "1.10", "1.11")]
    for age, file in enumerate(files):
        file.touch()
        os.utime(file, (age, age))
    assert sort_series(files[::-1]) == files
    for age, file in enumerate(sorted(files)):  # 1.10 first
        os.utime(file, (age, age))
    assert [file.stem for file in sort_series(files)] == ["1.10", "1.11", "1.8", "1.9"]


@pytest.mark.parametrize(
    ("stems", "times_s"),
    [
        (["1744664892050", "1744664892150"], [0, 0.1]),
        (["a_1744664892050000", "a_1744664892150000"], [0, 0.1]),
        (["1744664892050000000", "1744664892150000000"], [0, 0.1]),
        (["1744664892_950000000", "1744664893_50000000"], [0, 0.1]),
        (["000_1744664892.05", "001_1744664892.15"], [0, 0.1]),
        (["t_0.05", "t_0.15"], [0, 0.1]),
        (["2025-04-14_21-08-12.950", "2025-04-14_21-08-13.050"], [0, 0.1]),
        (["20250414_210812", "20250414_210814"], [0, 2]),
        (["frame_000", "frame_001"], None),
        (["1744664892_0001", "1744664892_0002"], None),
        (["x_0.5", "x_1.0"], None),
        (["20250414_210812_0001", "20250414_210812_0002"], None),
        (["1744664892", "1744664892"], None),
        (["1744664892"], None),
    ],
)
def test_times_in_names_are_seconds_after_the_first(stems: list[str], times_s: list[float] | None):
    found = parse_times_s(names_of(*stems))
    assert found is None if times_s is None else found == pytest.approx(times_s)


def test_a_folder_named_by_time_is_read_in_order_with_its_times(tmp_path: Path, touches):
    save(tmp_path / "background.png", touches.reference)
    for i, image in enumerate(touches.images):
        save(tmp_path / f"{round(START_S + 0.125 * i, 6)!r}.png", image)
    (stream,) = open_recording(tmp_path).streams
    frames = [stream.frame(i) for i in range(stream.n_frames)]
    assert [f.time_s for f in frames] == pytest.approx(
        [0.125 * i for i in range(len(touches.images))], abs=1e-5
    )
    assert all(
        np.array_equal(f.image, image) for f, image in zip(frames, touches.images, strict=True)
    )


@pytest.mark.parametrize(
    "names",
    [
        ("left_{}", "right_{}"),
        ("{}_L", "{}_R"),
        ("thumb{}", "index{}"),
        ("cam0_{}", "cam1_{}"),
        ("{}_finger_1_rgb", "{}_finger_2_rgb"),
        ("gelslim_{}", "digit_{}"),
    ],
)
def test_two_sensors_in_one_folder_are_two_streams(tmp_path: Path, touches, names):
    other = touches.images[::-1] // 2
    for i in range(len(touches.images)):
        save(tmp_path / f"{names[0].format(f'{i:03d}')}.png", touches.images[i])
        if i != 5:
            save(tmp_path / f"{names[1].format(f'{i:03d}')}.png", other[i])
    recording = open_recording(tmp_path)
    streams = {s.frame(0).origin.rsplit("/", 1)[1]: s for s in recording.streams}
    one, two = (streams[f"{name.format('000')}.png"] for name in names)
    # the pair of the lost image is left out, and noted
    assert one.n_frames == two.n_frames == len(touches.images) - 1
    assert any(
        note.startswith("1 images without one of the same number") for note in recording.notes
    )
    assert np.array_equal(one.frame(7).image, touches.images[8])
    assert np.array_equal(two.frame(7).image, other[8])


def test_each_of_two_sensors_has_its_own_reference(tmp_path: Path, touches):
    for name, share in (("left", 1.0), ("right", 0.5)):
        save(tmp_path / f"{name}_background.png", (touches.reference * share).astype(np.uint8))
        for i, image in enumerate(touches.images):
            save(tmp_path / f"{name}_{i}.png", (image * share).astype(np.uint8))
    left, right = open_recording(tmp_path).streams
    assert left.frame(9).reference.mean() == pytest.approx(
        2 * right.frame(9).reference.mean(), rel=0.02
    )
    with pytest.raises(SettingProblem, match=r"left, right\): choose one with --stream"):
        open_recording(tmp_path, reference=tmp_path / "left_background.png")
    left, right = open_recording(
        tmp_path, reference=tmp_path / "left_background.png", stream="right"
    ).streams
    assert np.array_equal(right.frame(9).reference, touches.reference), "the named one's"
    assert left.frame(9).reference.mean() == pytest.approx(touches.reference.mean(), rel=0.02), (
        "its own"
    )


@pytest.mark.parametrize("lost", [0, 5])
def test_two_sensors_of_one_folder_are_paired_by_the_times_in_their_names(
    tmp_path: Path, touches, lost: int
):
    other = touches.images[::-1] // 2
    indices = range(len(touches.images))
    for i in indices:
        save(tmp_path / f"left_{round(START_S + 0.125 * i, 6)!r}.png", touches.images[i])
        if i != lost:
            save(tmp_path / f"right_{round(START_S + 0.125 * i + 0.02, 6)!r}.png", other[i])
    left, right = open_recording(tmp_path).streams
    partners = pair_frames(left, right).partners.tolist()
    assert partners == [NO_PARTNER if i == lost else i - (i > lost) for i in indices]
    assert all(
        np.array_equal(right.frame(partners[i]).image, other[i]) for i in indices if i != lost
    )
    assert "1 of left have no partner" in pair_frames(left, right).note


def test_arrays_and_depth_images_have_the_times_of_their_names(tmp_path: Path, touches):
    depth = np.full((140, 175), 754, np.uint16)
    for i in range(4):
        (tmp_path / "colour").mkdir(exist_ok=True)
        np.save(tmp_path / "colour" / f"{1744664892000 + 125 * i}.npy", touches.images[i])
        save_depth = tmp_path / "depth_0p1mm" / f"{1744664892000 + 125 * i}.png"
        save_depth.parent.mkdir(exist_ok=True)
        assert cv2.imwrite(str(save_depth), depth)
    np.savez(tmp_path / "a.npz", frames=touches.images[:4], timestamps_s=0.125 * np.arange(4))
    for name in ("colour", "depth_0p1mm", "a.npz"):
        (stream,) = open_recording(tmp_path / name).streams
        assert stream.times_s.tolist() == pytest.approx([0.0, 0.125, 0.25, 0.375])
        assert stream.frame(2).time_s == pytest.approx(0.25)


def test_series_in_another_light_are_refused_with_both_names(tmp_path: Path, touches):
    for i, image in enumerate(touches.images):
        save(tmp_path / f"a_{i}.png", image)
        save(
            tmp_path / f"b_{i}.png",
            np.clip(image + np.array((25, -10, 5)), 0, 255).astype(np.uint8),
        )
    with pytest.raises(FileProblem, match=r"a_\* and b_\* differ in light"):
        open_recording(tmp_path)


def test_series_of_one_sensor_stay_one_recording(tmp_path: Path, touches):
    for i, image in enumerate(touches.images):
        save(tmp_path / f"ball_{i}.png", image)
        save(tmp_path / f"cube_{i}.png", touches.images[-i])
    (stream,) = open_recording(tmp_path).streams
    assert stream.n_frames == 2 * len(touches.images)
    assert split_sensors(names_of("index_0", "index_1", "frame_left_1")) == {}
