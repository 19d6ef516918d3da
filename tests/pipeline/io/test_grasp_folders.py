"""Folders of the touch2touch data set: splits, wrong pairs and companions of the published
layouts.
"""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import torch

from pipeline.core.errors import FileProblem
from pipeline.io import open_recording
from pipeline.io.inspection.recording_report import format_report_lines, inspect_recording
from tests.pipeline.io.test_tensors import bubble, gelslim, saved

TOOLS = ("pattern_33", "hex", "peg1")


def save_pair(
    root: Path, split: str, tool: str, number: int, *, nested: bool = False, **changes
) -> None:
    for kind, word, sample in (("bubbles", "bubble", bubble), ("gelslims", "gelslim", gelslim)):
        plural = "bubbles" if kind == "bubbles" else "gelslim"
        name = (
            f"data/{word}_style_transfer_dataset_{plural}_{tool}/data_{number}.pt"
            if nested
            else f"{tool}_data_{number}.pt"
        )
        saved(root / split / kind / name, {**sample(number), **changes.get(kind, {})})


@pytest.fixture
def data(tmp_path: Path) -> Path:
    """18 pairs trained on, 6 new grasps and 6 of an unseen tool.

    The numbers of all splits are the same.
    """
    root = tmp_path / "data"
    for tool in TOOLS[:2]:
        for number in range(9):
            save_pair(root, "train", tool, number, nested=True)
        for number in range(3):
            save_pair(root, "test/train_only", tool, number)
    for number in range(6):
        save_pair(root, "test/test_only", TOOLS[2], number)
    return root


def test_splits_are_kept_and_counted(data: Path):
    recording = open_recording(data)
    assert [s.n_frames for s in recording.streams] == [30, 30, 30, 30]
    counts = Counter(grasp.split for grasp in recording.grasps)
    assert list(counts.items()) == [("train", 18), ("test/test_only", 6), ("test/train_only", 6)]
    assert {g.tool for g in recording.grasps if g.split == "test/test_only"} == {"peg1"}
    (note,) = (n for n in recording.notes if "grasps of" in n)
    assert (
        note
        == "30 grasps of 3 tools, two fingers each: 18 train + 6 test/test_only + 6 test/train_only"
    )
    last = recording.grasps.index(
        next(g for g in recording.grasps if g.name == "hex 2 (test/train_only)")
    )
    assert recording.stream("gelslim right").frame(last).image[0, 0, 0] == 102
    assert "test/train_only" in recording.stream("soft_bubble left").frame(last).origin


def test_inspect_names_a_wrong_pair_and_one_without_partner(data: Path):
    save_pair(data, "train", "hex", 20, nested=True, bubbles={"theta": torch.tensor(0.7)})
    saved(data / "train/bubbles/hex_data_40.pt", bubble(4))
    report = inspect_recording(data)
    (check,) = (c for c in report.checks if c.name == "grasps")
    assert check.state == "fail"
    assert check.text == "hex 20 (train): theta is 0.1 for one sensor and 0.7 for the other"
    text = "\n".join(format_report_lines(report))
    assert "hex 40 (train) (only soft_bubble)" in text
    assert "19 train + 6 test/test_only + 6 test/train_only" in text


def test_split_json_names_the_splits_of_what_is_trained_on(data: Path):
    split = {
        "train": [["hex", n] for n in range(1, 9)],
        "val": [["hex", 0]],
        "test": [["pattern_33", "data_4"], ["gone", 1]],
    }
    (data / "split.json").write_text(json.dumps(split))
    recording = open_recording(data)
    counts = Counter(grasp.split for grasp in recording.grasps)
    assert counts == {"train": 16, "val": 1, "test": 1, "test/test_only": 6, "test/train_only": 6}
    assert any(
        "1 grasps of split.json are not in the folder: gone 1" in note for note in recording.notes
    )


@pytest.mark.parametrize(
    "text",
    ["[]", "{", '{"train": 3}', '{"train": [["hex"]]}', '{"a": [["hex", 1]], "b": [["hex", 1]]}'],
)
def test_a_split_file_of_another_kind_is_refused_by_its_name(data: Path, text: str):
    (data / "split.json").write_text(text)
    with pytest.raises(FileProblem, match=r"split\.json"):
        open_recording(data)


def test_undistorted_images_predictions_and_depth_do_not_mix_with_the_grasps(tmp_path: Path):
    root = tmp_path / "T2D2"
    save_pair(root, "train_evaluation", "hex", 3)
    saved(root / "train_evaluation/gelslims_undistorted/hex_data_3.pt", gelslim(50))
    depth = torch.zeros(1, 2, 140, 175)
    depth[0, 0, 70, 80] = 0.072
    saved(root / "train_evaluation/bubbles_depth/hex_data_3.pt", {"depth": depth})
    saved(
        root / "test/diffusion_results/gelslim2bubble/results_samples_right/all/hex_data_3.pt",
        {"prediction": torch.zeros(1, 3, 8, 8)},
    )
    recording = open_recording(root)
    assert recording.stream("gelslim right").frame(0).image[0, 0, 0] == 103
    notes = " ".join(recording.notes)
    assert "gelslims is read; gelslims_undistorted is left out" in notes
    assert "1 files are left out, which hold neither" in notes
    truth, other = (
        recording.stream(f"soft_bubble {finger}").truth(0) for finger in ("right", "left")
    )
    assert truth is not None
    assert other is not None
    assert truth.contact.sum() == 1
    assert truth.indentation_mm[70, 80] == pytest.approx(8.0, abs=1e-3)
    assert truth.sensor_from_object is not None
    assert not other.contact.any()


def test_grasps_of_one_finger_are_one_pair_each(tmp_path: Path):
    root = tmp_path / "data"
    right = ("bubble_imprint", "bubble_depth_ref", "K", "gelslim", "gelslim_ref")
    for number in range(2):
        save_pair(root, "train", "hex", number)
    for file in root.rglob("*.pt"):
        tensors = torch.load(file)
        saved(file, {key: value[:1] if key in right else value for key, value in tensors.items()})
    recording = open_recording(root)
    assert [s.name for s in recording.streams] == ["gelslim right", "soft_bubble right"]
    assert recording.notes[0].startswith("2 grasps of 1 tool, one finger each")
    assert recording.stream("gelslim right").frame(1).image[0, 0, 0] == 101
    assert recording.stream("soft_bubble right").frame(0).image[70, 80] == pytest.approx(
        70.0, abs=1e-3
    )
    file = next((root / "train" / "gelslims").glob("*_0.pt"))
    saved(file, {**torch.load(file), "gelslim_ref": torch.zeros(3, 3, 320, 427)})
    with pytest.raises(
        FileProblem, match=r"gelslim_ref must have shape \(2, 3, 320, 427\), got \(3, 3"
    ):
        open_recording(root).stream("gelslim right").frame(0)


@pytest.mark.parametrize(
    "names", [("gelslims_no_distortion",), ("gelslims", "gelslims_no_distortion")]
)
def test_undistorted_images_are_read_where_there_are_no_others(
    tmp_path: Path, names: tuple[str, ...]
):
    for number in range(2):
        saved(tmp_path / "train" / "bubbles" / f"hex_data_{number}.pt", bubble(number))
        for k, name in enumerate(names):
            saved(tmp_path / "train" / name / f"hex_data_{number}.pt", gelslim(number + 10 * k))
    recording = open_recording(tmp_path)
    assert [s.n_frames for s in recording.streams] == [2, 2, 2, 2]
    assert recording.stream("gelslim right").frame(1).image[0, 0, 0] == 101


def test_a_folder_of_tool_folders_is_one_set(tmp_path: Path):
    for tool in TOOLS:
        save_pair(tmp_path, "", tool, 1, nested=True)
    recording = open_recording(tmp_path / "bubbles" / "data")
    assert sorted(g.tool for g in recording.grasps) == sorted(TOOLS)
    assert np.isfinite(recording.streams[0].frame(2).image).all()
