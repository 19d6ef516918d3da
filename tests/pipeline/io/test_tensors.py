"""The field's tensor files and depth arrays, as small files of the same structure."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from pipeline.core.errors import CalibrationError, FileProblem
from pipeline.core.geometry import rigid
from pipeline.io import open_recording

FLOAT_ROUNDING_MM = 1e-4  # of float32 metres at 0.1 m, with a margin of ten
K = [[186.0, 0.0, 111.5], [0.0, 187.0, 85.0], [0.0, 0.0, 1.0]]


def bubble(n: int = 0) -> dict[str, torch.Tensor]:
    imprint = torch.zeros(2, 1, 140, 175)
    imprint[0, 0, 70, 80] = 0.010
    imprint[1, 0, 70, 80] = 0.020 + 0.001 * n
    half_turn = [0.5, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0]  # 180 degrees about z, half a metre along x
    return {
        "bubble_imprint": imprint,
        "bubble_depth_ref": torch.full((2, 1, 140, 175), 0.080),
        "K": torch.tensor([K, K]),
        "bubbles_tr_quat": torch.tensor([[half_turn], [half_turn]]),
        "tool_tr_quat": torch.tensor([0.5, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0]),
        "theta": torch.tensor(0.1),
    }


def gelslim(n: int = 0) -> dict[str, torch.Tensor]:
    images = torch.zeros(2, 3, 320, 427)
    # right finger red, left finger blue
    images[0, 0] = 100.0 + n
    images[1, 2] = 50.0
    return {
        "gelslim": images,
        "gelslim_ref": torch.full((2, 3, 320, 427), 7.0),
        "theta": torch.tensor(0.1),
    }


def depth_dictionary() -> dict[str, torch.Tensor]:
    images = torch.zeros(3, 6, 320, 427)
    # left finger's red, right finger's blue
    images[:, 0] = 90.0
    images[:, 5] = 60.0
    depth = torch.zeros(3, 2, 320, 427)
    depth[1, 0, 5, 6] = -1.5
    return {
        "tactile_image": images,
        "base_tactile_image": torch.full((1, 6, 320, 427), 9.0),
        "depth_image": depth,
        "in_hand_pose": torch.zeros(3, 3),
    }


def saved(path: Path, content: object) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    torch.save(content, path)
    return path


def test_a_bubble_sample_is_depth_in_mm_with_the_window_of_its_camera(tmp_path: Path):
    recording = open_recording(saved(tmp_path / "data_3.pt", bubble()))
    assert [(s.name, s.sensor) for s in recording.streams] == [
        ("soft_bubble right", "soft_bubble"),
        ("soft_bubble left", "soft_bubble"),
    ]
    right, left = (s.frame(0) for s in recording.streams)
    assert right.image[70, 80] == pytest.approx(70.0, abs=FLOAT_ROUNDING_MM)
    assert left.image[70, 80] == pytest.approx(60.0, abs=FLOAT_ROUNDING_MM)
    assert right.reference[70, 80] == pytest.approx(80.0, abs=FLOAT_ROUNDING_MM)
    assert (right.camera.cx_px, right.camera.cy_px) == (111.5 - 25, 85.0 - 20)
    assert right.camera.shape == right.image.shape == (140, 175)


def test_the_pose_of_the_tool_is_in_the_bubble_camera_frame(tmp_path: Path):
    truth = open_recording(saved(tmp_path / "data_3.pt", bubble())).streams[0].truth(0)
    want = rigid.from_parts((0.0, 0.0, 100.0), (0.0, 0.0, 180.0))  # turned back and 0.1 m up
    np.testing.assert_allclose(truth.sensor_from_object, want, atol=FLOAT_ROUNDING_MM)


def test_the_frame_between_the_fingers_is_known_where_it_is_recorded(tmp_path: Path):
    # half way from the camera to the tool
    grasp = torch.tensor([[0.5, 0.0, 0.05, 0.0, 0.0, 0.0, 1.0]])
    path = saved(tmp_path / "data_3.pt", {**bubble(), "grasp_frame_quat": grasp})
    truth = open_recording(path).streams[1].truth(0)
    tool_in_grasp = rigid.apply(
        truth.grasp_from_sensor @ truth.sensor_from_object, np.zeros((1, 3))
    )
    np.testing.assert_allclose(tool_in_grasp, [[0.0, 0.0, 50.0]], atol=FLOAT_ROUNDING_MM)


def test_a_gelslim_sample_keeps_fingers_and_colours(tmp_path: Path):
    right, left = open_recording(saved(tmp_path / "data_3.pt", gelslim())).streams
    assert right.frame(0).image[5, 6].tolist() == [100, 0, 0]
    assert left.frame(0).image[5, 6].tolist() == [0, 0, 50]
    assert right.frame(0).reference[5, 6].tolist() == [7, 7, 7]


@pytest.mark.parametrize("flat", [True, False])
def test_folders_pair_the_grasps_of_both_sensors(tmp_path: Path, flat: bool):
    for n in (2, 10, 30):
        for kind, word, sample in (("bubbles", "bubble", bubble), ("gelslims", "gelslim", gelslim)):
            if n == 30 and kind == "gelslims":
                continue
            last = "bubbles" if kind == "bubbles" else "gelslim"
            place = (
                f"hex_data_{n}.pt"
                if flat
                else f"data/{word}_style_transfer_dataset_{last}_hex/data_{n}.pt"
            )
            saved(tmp_path / kind / place, sample(n))
    recording = open_recording(tmp_path)
    assert [s.name for s in recording.streams] == [
        "gelslim right",
        "gelslim left",
        "soft_bubble right",
        "soft_bubble left",
    ]
    for index, n in enumerate((2, 10)):
        assert recording.stream("gelslim right").frame(index).image[0, 0, 0] == 100 + n
        depth = recording.stream("soft_bubble left").frame(index).image[70, 80]
        assert depth == pytest.approx(60.0 - n, abs=FLOAT_ROUNDING_MM)
    assert recording.streams[0].n_frames == 2
    assert "1 grasps of only one sensor are left out: hex 30 (only soft_bubble)" in recording.notes


def test_a_depth_dictionary_gives_both_fingers_and_positive_indentation(tmp_path: Path):
    recording = open_recording(saved(tmp_path / "peg_train.pt", depth_dictionary()))
    left, right = recording.streams
    assert (left.name, right.name, left.n_frames) == ("left", "right", 3)
    assert left.frame(0).image[0, 0].tolist() == [90, 0, 0]
    assert right.frame(2).image[0, 0].tolist() == [0, 0, 60]
    assert left.frame(2).reference[0, 0].tolist() == [9, 9, 9]
    assert left.truth(1).indentation_mm[5, 6] == pytest.approx(1.5)
    assert left.truth(0).indentation_mm.max() == 0.0
    assert any("in_hand_pose is left out" in note for note in recording.notes)


def test_a_depth_dictionary_of_another_size_is_resampled_with_its_depth(tmp_path: Path):
    content = depth_dictionary()
    content["depth_image"][1, 0] = -1.5
    twice = {
        k: v if v.dim() < 4 else v.repeat_interleave(2, 2).repeat_interleave(2, 3)
        for k, v in content.items()
    }
    recording = open_recording(saved(tmp_path / "peg_train.pt", twice))
    own = open_recording(saved(tmp_path / "own.pt", content))
    for one, other in zip(recording.streams, own.streams, strict=True):
        assert np.array_equal(one.frame(1).image, other.frame(1).image)
        assert np.array_equal(one.frame(1).reference, other.frame(1).reference)
        assert np.allclose(one.truth(1).indentation_mm, other.truth(1).indentation_mm)
    assert any("854 x 640 px are resampled" in note for note in recording.notes)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (
            {**depth_dictionary(), "tactile_image": torch.zeros(3, 6, 320, 640)},
            "640 x 320 px.* same proportions",
        ),
        ({"weights": torch.zeros(2)}, "tactile_image.*weights"),
        ([torch.zeros(2)], "must hold a dictionary of tensors"),
        (
            {"gelslim": torch.zeros(2, 3, 10, 10)},
            r"gelslim must have shape \(2, 3, 320, 427\), got \(2, 3, 10, 10\)",
        ),
        ({"path": Path("x")}, "loading it could run code"),
        ({**gelslim(), "gelslim": gelslim()["gelslim"] / 255}, "none exceeds .* are they 0 to 1"),
        ({k: v for k, v in bubble().items() if k != "K"}, "the key 'K' is missing"),
        ({**bubble(), "bubble_depth_ref": torch.full((2, 1, 140, 175), 80.0)}, "must be in metres"),
        ({**bubble(), "K": torch.zeros(2, 3, 3)}, "K is singular"),
    ],
)
def test_invalid_tensor_files_are_refused(tmp_path: Path, content, message: str):
    with pytest.raises((FileProblem, CalibrationError), match=message) as caught:
        open_recording(saved(tmp_path / "odd.pt", content)).streams[0].frame(0)
    assert "odd.pt" in str(caught.value)


def odd_values(good: torch.Tensor) -> dict[str, object]:
    """What else than plain real numbers may stand under a key, in the shape that is right."""
    return {
        "complex": good.to(torch.complex64),
        "truth values": good.bool(),
        "sparse": good.to_sparse(),
        "on no device": good.to("meta"),
        "a number": 3.0,
        "words": ["a", "b"],
        "nothing": None,
        "a dictionary": {"a": good},
        "no dimension": good.sum(),
        "empty": good[:0],
        "one dimension more": good[None, None],
        "one number less": good.flatten()[:-1],
        "not a number": good.float() * float("nan"),
        "infinite": good.float() + float("inf"),
        "beyond all": good.double() + 1e300,
    }


@pytest.mark.parametrize(
    ("make", "key"),
    [
        (make, key)
        for make in (bubble, gelslim, depth_dictionary)
        for key in make()
        if key not in ("theta", "in_hand_pose")
    ],
)
def test_tensors_of_unusual_types_are_refused_by_their_key(tmp_path: Path, make, key: str):
    refused = []
    for what, odd in odd_values(make()[key]).items():
        path = saved(tmp_path / f"{key}.pt", {**make(), key: odd})
        try:
            recording = open_recording(path)
            for stream in recording.streams:
                image = stream.frame(0).image
                assert image.dtype in (np.uint8, np.float32)
                truth = stream.truth(0)
                assert (
                    truth is None
                    or truth.sensor_from_object is None
                    or np.isfinite(truth.sensor_from_object).all()
                )
        except (FileProblem, CalibrationError) as error:
            refused.append(what)
            assert path.name in str(error), what  # noqa: PT017
    # rows of poses and cameras; depth without a reading
    may_pass = {"one dimension more", "not a number"}
    assert set(odd_values(make()[key])) - set(refused) <= may_pass


ODD_ARRAYS = {
    "words": np.array(["a", "b"]),
    "complex": np.ones((2, 6, 7), np.complex64),
    "days": np.ones((2, 6, 7), "m8[s]"),
    "pairs": np.zeros((2, 6, 7), [("a", "f4")]),
    "truth values": np.ones((2, 6, 7), bool),
    "wide": np.ones((2, 6, 7), "f16"),
    "flat": np.ones(6),
    "five": np.ones((1, 2, 6, 7, 1)),
    "none": np.ones((0, 6, 7)),
}


@pytest.mark.parametrize("what", ODD_ARRAYS)
@pytest.mark.parametrize("name", ["depth_mm", "K", "timestamps_s"])
def test_depth_arrays_of_unusual_types_are_refused_or_left_out(
    tmp_path: Path, what: str, name: str
):
    good = {
        "depth_mm": np.full((2, 6, 7), 80.0),
        "K": np.diag([20.0, 20.0, 1.0]),
        "timestamps_s": np.arange(2.0),
    }
    np.savez(tmp_path / "odd.npz", **{**good, name: ODD_ARRAYS[what]})
    if name == "timestamps_s":
        assert np.isnan(
            open_recording(tmp_path / "odd.npz", depth_unit="mm").streams[0].frame(1).time_s
        )
        return
    with pytest.raises((FileProblem, CalibrationError), match=r"odd\.npz"):
        open_recording(tmp_path / "odd.npz").streams[0].frame(0)


@pytest.mark.parametrize(
    "content", [b"hello, I am no tensor", b"PK\x03\x04 and nothing more", b"\x80\x02junk"]
)
def test_a_pt_file_that_is_not_one_is_refused(tmp_path: Path, content: bytes):
    (tmp_path / "a.pt").write_bytes(content)
    with pytest.raises(
        FileProblem, match=r"not a PyTorch file, or it is cut short|could run code|before 1\.6"
    ):
        open_recording(tmp_path / "a.pt")


def test_a_truncated_pt_file_is_refused(tmp_path: Path):
    path = saved(tmp_path / "a.pt", bubble())
    path.write_bytes(path.read_bytes()[:50_000])
    with pytest.raises(FileProblem, match="cut short"):
        open_recording(path)


def depth_counts() -> np.ndarray:
    counts = np.full((8, 12, 16), 800, np.uint16)
    counts[:, 0, 0] = 0
    counts[:, 1, 1] = 65535
    counts[7, 5, 5] = 750
    return counts


def test_punyo_arrays_are_mm_with_gaps_and_their_camera(tmp_path: Path):
    k = np.array([[20.0, 0, 8], [0, 20, 6], [0, 0, 1]])
    np.savez(
        tmp_path / "p.npz",
        depth_u16_0p1mm=depth_counts(),
        K=k,
        frame=np.arange(8),
        pressure_hPa=np.ones(8),
    )
    recording = open_recording(tmp_path / "p.npz")
    frame = recording.streams[0].frame(7)
    assert frame.image[5, 5] == pytest.approx(75.0)
    assert np.isnan(frame.image[0, 0])
    assert np.isnan(frame.image[1, 1])
    assert np.isnan(frame.reference[0, 0])
    assert frame.reference[5, 5] == pytest.approx(80.0)
    assert (frame.camera.cx_px, frame.sensor) == (8.0, "soft_bubble")
    assert any("pressure_hPa" in note for note in recording.notes)


@pytest.mark.parametrize(
    ("name", "scale"), [("depth_mm", 1.0), ("depth_m", 0.001), ("my_depth_um", 1000.0)]
)
def test_the_unit_follows_from_the_name(tmp_path: Path, name: str, scale: float):
    np.save(tmp_path / f"{name}.npy", np.full((2, 6, 7), 80.0 * scale, np.float32))
    image = open_recording(tmp_path / f"{name}.npy").streams[0].frame(1).image
    np.testing.assert_allclose(image, 80.0, atol=FLOAT_ROUNDING_MM)


def test_a_depth_array_without_a_unit_is_refused_by_its_key(tmp_path: Path):
    np.savez(tmp_path / "p.npz", depth=np.full((2, 6, 7), 80.0))
    with pytest.raises(FileProblem, match="cannot tell the unit of 'depth'"):
        open_recording(tmp_path / "p.npz")
    assert (
        open_recording(tmp_path / "p.npz", depth_unit="mm").streams[0].frame(0).image[0, 0] == 80.0
    )


def test_metres_named_millimetres_are_refused(tmp_path: Path):
    np.savez(tmp_path / "p.npz", depth_mm=np.full((2, 6, 7), 0.08))
    with pytest.raises(FileProblem, match=r"median of 0\.08 mm when read in mm"):
        open_recording(tmp_path / "p.npz")


def test_pickled_and_damaged_arrays_are_refused(tmp_path: Path):
    np.savez(tmp_path / "pickled.npz", depth_mm=np.array([{}], dtype=object))
    with pytest.raises(FileProblem, match="could run code"):
        open_recording(tmp_path / "pickled.npz")
    np.savez(tmp_path / "cut.npz", depth_mm=np.full((2, 6, 7), 80.0))
    (tmp_path / "cut.npz").write_bytes((tmp_path / "cut.npz").read_bytes()[:200])
    with pytest.raises(FileProblem, match="cut short or damaged"):
        open_recording(tmp_path / "cut.npz")


def test_a_folder_of_sixteen_bit_images_is_depth(tmp_path: Path):
    folder = tmp_path / "depth_0p1mm"
    folder.mkdir()
    for index, counts in enumerate(depth_counts()):
        cv2.imwrite(str(folder / f"{index}.png"), counts)
    stream = open_recording(folder).streams[0]
    assert stream.n_frames == 8
    assert stream.frame(7).image[5, 5] == pytest.approx(75.0)


def test_the_real_bubble_sequence_is_centimetres_away(real_data: Path):
    recording = open_recording(real_data / "punyo_bubble" / "depth_sequence.npz")
    frame = recording.streams[0].frame(20)
    assert 50.0 < np.nanmedian(frame.image) < 150.0
    assert frame.camera.fx_px == pytest.approx(434.27, abs=0.01)
