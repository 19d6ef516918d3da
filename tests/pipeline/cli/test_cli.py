"""The commands as a user types them: what they leave behind, and one clear sentence for each
mistake.
"""

from __future__ import annotations

import json
import logging
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import h5py
import numpy as np
import pytest

from pipeline.calibration import calibration_file, calibration_table
from pipeline.cli import calibrate
from pipeline.cli.main import EXIT_USER_ERROR, build_app, run_app
from pipeline.sensors.descriptions import find_descriptions
from pipeline.sensors.spec import load_sensor
from tests.pipeline.cli.conftest import MINI, save

pytestmark = pytest.mark.usefixtures("shared_results")
SAMPLE = Path(__file__).parents[3] / "sample_data" / "recordings" / "first_touch.h5"


@pytest.fixture
def said(capsys):
    """Run a command line that must fail on the user's account; returns its one sentence."""

    def go(*tokens):
        code = run_app(build_app(), [str(t) for t in tokens])
        error = capsys.readouterr().err
        assert code == EXIT_USER_ERROR, error
        assert "Traceback" not in error
        lines = [line for line in error.splitlines() if line.startswith("tactoscope: ")]
        assert len(lines) == 1, error
        return lines[0].removeprefix("tactoscope: ")

    return go


def test_translate_all_leaves_every_frame_whole(touches, tmp_path, capsys):
    out = tmp_path / "out"
    code = run_app(
        build_app(),
        [
            "translate",
            str(touches),
            "--target",
            "gelslim",
            "--all",
            "--out",
            str(out),
            "--sensor",
            "gelsight_mini",
        ],
    )
    assert code == 0, capsys.readouterr().err
    report = json.loads((out / "report.json").read_text())
    assert report["route"] == "t2d2"
    assert [f["index"] for f in report["frames"]] == [0, 1, 2]
    for frame in report["frames"]:
        assert [s["name"] for s in frame["stages"]] == [
            "depth",
            "cloud",
            "target_depth",
            "touch",
            "touch_depth",
            "pose",
        ]
        assert all(set(s) >= {"name", "ms", "skipped", "notes"} for s in frame["stages"])
    assert all(s["skipped"] for s in report["frames"][0]["stages"])
    assert not report["frames"][2]["stages"][0]["skipped"]
    with np.load(out / "frame_0002" / "stages.npz", allow_pickle=False) as arrays:
        assert arrays["depth.indentation_mm"].shape == MINI.camera.shape
        assert arrays["touch.image"].shape == (*load_sensor("gelslim").camera.shape, 3)
        assert arrays["depth.contact"].any()
    sheet = cv2.imread(str(out / "frame_0002" / "sheet.png"))
    assert sheet.shape[1] > 1000
    assert not list(out.glob(".*"))


def test_a_setting_reaches_its_stage_and_an_unknown_one_is_named(touches, tmp_path, said):
    arguments = (
        "translate",
        touches,
        "--target",
        "gelslim",
        "--sensor",
        "gelsight_mini",
        "--out",
        tmp_path / "o",
    )
    assert (
        run_app(
            build_app(),
            [str(a) for a in (*arguments, "--set", "target_depth.jump_mm=2", "--frame", "2")],
        )
        == 0
    )
    assert "jump_mm" in said(*arguments, "--set", "target_depth.colour=red")
    assert said(*arguments, "--set", "projekt.mode=paper").startswith(
        "no stage 'projekt' on this route; there are depth, cloud"
    )
    assert said(*arguments, "--set", "mode").startswith(
        "a setting is written stage.parameter=value"
    )


def test_the_sample_recording_translates_with_truth(tmp_path, capsys):
    out = tmp_path / "out"
    assert (
        run_app(
            build_app(),
            [
                "translate",
                str(SAMPLE),
                "--target",
                "soft_bubble",
                "--sensor",
                "gelslim",
                "--out",
                str(out),
            ],
        )
        == 0
    )
    frame = json.loads((out / "report.json").read_text())["frames"][0]
    assert frame["metrics"]["depth.contact_mae_mm"] < 0.15
    assert "touch_depth.contact_iou" in frame["metrics"]


@pytest.mark.parametrize("known", [False, True])
def test_calibrating_states_the_expected_error_and_what_one_ball_does_not_determine(
    known, touches, tmp_path, capsys
):
    (touches / "touch_0.png").unlink()
    pixel = ["--pixel-mm", "0.06"] if known else []
    out = tmp_path / "mini"
    command = [
        "calibrate",
        "balls",
        str(touches),
        "--sensor",
        "gelsight_mini",
        "--diameter-mm",
        "8",
        *pixel,
        "--reference",
        str(touches / "background.png"),
        "--out",
        str(out),
        "--pattern",
        "touch_*",
    ]
    assert run_app(build_app(), command) == 0
    outcome = " ".join(capsys.readouterr().out.split())
    assert "expected error of a ball's diameter" in outcome
    assert ("do not determine the pixel width" in outcome) is not known
    assert f"calibration written to {out}.npz" in outcome
    assert calibration_file.load(tmp_path / "mini.npz").expected_error is not None


def test_a_sensor_described_by_a_file_of_ones_own_is_calibrated(touches, tmp_path):
    (touches / "touch_0.png").unlink()
    described = find_descriptions()["gelsight_mini"].read_text(encoding="utf-8")
    (tmp_path / "mine.toml").write_text(described, encoding="utf-8")
    command = [
        "calibrate",
        "balls",
        str(touches),
        "--sensor",
        str(tmp_path / "mine.toml"),
        "--diameter-mm",
        "8",
        "--reference",
        str(touches / "background.png"),
        "--out",
        str(tmp_path / "mine.npz"),
        "--pattern",
        "touch_*",
    ]
    assert run_app(build_app(), command) == 0
    assert calibration_file.load(tmp_path / "mine.npz").sensor == "mine"


def test_a_copy_of_a_press_does_not_count(touches, tmp_path, capsys, monkeypatch):
    mini = load_sensor("gelsight_mini")
    presses = list[int]()

    def calibrate_sensor(images, *_, **__):
        presses.append(len(images))
        return calibration_table.make_built_in(mini)

    monkeypatch.setattr(calibrate, "calibrate_sensor", calibrate_sensor)
    command = [
        "calibrate",
        "balls",
        str(touches),
        "--sensor",
        "gelsight_mini",
        "--diameter-mm",
        "8",
        "--reference",
        str(touches / "background.png"),
        "--out",
        str(tmp_path / "mini.npz"),
        "--pattern",
        "touch_*",
    ]
    assert run_app(build_app(), command) == 0
    shutil.copy(touches / "touch_1.png", touches / "touch_again.png")
    assert run_app(build_app(), command) == 0
    assert presses[0] == presses[1]
    assert "1 images are copies of others and left out" in capsys.readouterr().out


def test_calibrating_on_images_with_swapped_colours_gives_a_warning(
    touches, tmp_path, capsys, monkeypatch
):
    mini = load_sensor("gelsight_mini")
    monkeypatch.setattr(
        calibrate, "calibrate_sensor", lambda *_, **__: calibration_table.make_built_in(mini)
    )
    command = [
        "calibrate",
        "balls",
        str(touches),
        "--sensor",
        "gelsight_mini",
        "--diameter-mm",
        "8",
        "--reference",
        str(touches / "background.png"),
        "--out",
        str(tmp_path / "mini.npz"),
        "--pattern",
        "touch_*",
    ]
    assert run_app(build_app(), command) == 0
    assert "warning" not in capsys.readouterr().out
    for file in touches.iterdir():
        cv2.imwrite(str(file), cv2.imread(str(file))[..., ::-1])
    assert run_app(build_app(), command) == 0
    assert "red and blue look swapped" in capsys.readouterr().out


def test_inspect_says_what_a_calibration_is_worth(tmp_path, capsys):
    error = calibration_table.ExpectedError(
        diameter_share=0.08, diameter_p90=0.19, depth_share=0.07, depth_p90=0.17, n_held_out=4
    )
    press = calibration_table.BallFit(
        index=0, x_px=9, y_px=9, radius_px=9, residual=0.02, used=True
    )
    known = replace(
        calibration_table.make_built_in(load_sensor("gelsight_mini")),
        presses=(press,),
        expected_error=error,
    )
    calibration_file.save(known, tmp_path / "mini.npz")
    assert run_app(build_app(), ["inspect", str(tmp_path / "mini.npz")]) == 0
    assert "up to 19 % in nine of ten touches" in capsys.readouterr().out


def test_inspect_says_what_the_sample_is(capsys):
    assert run_app(build_app(), ["inspect", str(SAMPLE)]) == 0
    text = capsys.readouterr().out
    assert "gelslim" in text
    assert "soft_bubble" in text
    assert "ok   gelslim with soft_bubble: strength and place of 16 moments agree" in text


def test_doctor_finds_a_complete_installation(capsys):
    code = run_app(build_app(), ["doctor"])
    printed = capsys.readouterr().out
    assert code == 0, printed
    assert printed.splitlines()[-1] == "everything is installed"
    assert "MISSING" not in printed


def test_doctor_counts_what_is_missing(capsys, monkeypatch):
    from pipeline.cli import doctor

    monkeypatch.setattr(doctor, "_PACKAGES", ("numpy", "no-such-package", "nor-this-one"))
    code = run_app(build_app(), ["doctor"])
    printed = capsys.readouterr().out
    assert code == 1
    assert "MISSING  no-such-package; run 'make setup'" in printed
    assert printed.splitlines()[-1].startswith("2 things are missing")


def test_a_missing_file_is_named(tmp_path, said):
    assert "nowhere.h5" in said("inspect", tmp_path / "nowhere.h5")


def test_an_unknown_sensor_is_answered_with_the_known_ones(touches, tmp_path, said):
    sentence = said("translate", touches, "--target", "gelslam", "--out", tmp_path / "o")
    assert sentence.startswith("unknown sensor 'gelslam'; known are digit, gelsight_mini, gelslim")


def test_an_unknown_route_is_answered_with_the_known_ones(touches, tmp_path, said):
    assert (
        said("translate", touches, "--target", "gelslim", "--route", "x2y", "--out", tmp_path)
        == "no route 'x2y'; there are t2d2, t2t, object"
    )


def test_an_empty_folder_says_so(tmp_path, said):
    (tmp_path / "empty").mkdir()
    assert "empty" in said("inspect", tmp_path / "empty")


def test_a_truncated_recording_is_one_sentence(tmp_path, said):
    path = tmp_path / "cut.h5"
    path.write_bytes(SAMPLE.read_bytes()[:2000])
    assert "cut.h5" in said("inspect", path)


def test_a_pt_that_is_none_is_one_sentence(tmp_path, said):
    path = tmp_path / "fake.pt"
    path.write_bytes(b"not a tensor file" * 10)
    sentence = said("inspect", path)
    assert sentence.startswith("this is not a PyTorch file")
    assert "fake.pt" in sentence


def test_a_recording_without_reference_asks_for_one(touches, tmp_path, said):
    (touches / "background.png").unlink()
    sentence = said_by_frame(touches, tmp_path, said)
    assert "reference" in sentence


def test_an_image_of_the_wrong_size_is_named_with_both_sizes(touches, tmp_path, said):
    for path in touches.iterdir():
        save(path, np.zeros((100, 120, 3), np.uint8) + 90)
    sentence = said_by_frame(touches, tmp_path, said)
    assert "100" in sentence
    assert "240" in sentence


def test_a_recording_of_no_frame_is_no_success(tmp_path, said, capsys):
    path = tmp_path / "none.h5"
    path.write_bytes(SAMPLE.read_bytes())
    with h5py.File(path, "r+") as file:
        each = []
        file["streams"].visititems(
            lambda _, found: each.append(found) if isinstance(found, h5py.Dataset) else None
        )
        for found in each:
            name = found.name
            attributes = dict(found.attrs)
            if not name.endswith("references"):
                cut = found[:0]
                del file[name]
                file.create_dataset(name, data=cut).attrs.update(attributes)
    assert said("translate", path, "--target=gelslim", "--all", "--out", tmp_path / "o").startswith(
        "the recording holds"
    )
    assert not (tmp_path / "o").exists()
    assert run_app(build_app(), ["inspect", str(path)]) == 1
    assert "there is no frame" in capsys.readouterr().out


def test_a_decimal_comma_is_answered_with_the_point(touches, tmp_path, said):
    outcome = said(
        "translate",
        touches,
        "--target=digit",
        "--out",
        tmp_path / "out",
        "--translation-mm",
        "1,5",
        "0",
        "0",
    )
    assert "use a decimal point: 1.5" in outcome


def test_messages_of_matplotlib_are_hidden(tmp_path, said):
    said("inspect", tmp_path / "none.h5")
    assert not logging.getLogger("matplotlib.font_manager").isEnabledFor(logging.WARNING)


def test_following_takes_all_frames(touches, tmp_path, said):
    asked = (
        "translate",
        touches,
        "--target",
        "gelslim",
        "--sensor",
        "gelsight_mini",
        "--out",
        tmp_path / "out",
    )
    assert "give it with --all" in said(*asked, "--follow")


def test_an_all_black_frame_is_refused(touches, tmp_path, said):
    save(touches / "touch_2.png", np.zeros((*MINI.camera.shape, 3), np.uint8))
    assert "black" in said_by_frame(touches, tmp_path, said)


def test_a_mesh_in_metres_is_refused_with_what_to_try(touches, tmp_path, said):
    mesh = tmp_path / "tool.stl"
    write_box_stl(mesh, 0.02)
    sentence = said(
        "translate",
        touches,
        "--target",
        "gelslim",
        "--sensor",
        "gelsight_mini",
        "--mesh",
        mesh,
        "--mesh-unit",
        "mm",
        "--out",
        tmp_path / "o",
    )
    assert "m" in sentence
    assert "tool.stl" in sentence


def test_a_depth_frame_of_nothing_but_nan_is_refused(tmp_path, said):
    path = tmp_path / "nan.npz"
    rest = np.full((3, 140, 175), 80.0, np.float32)
    rest[1:] = np.nan
    np.savez(path, depth_mm=rest)
    assert said(
        "translate",
        path,
        "--target",
        "gelslim",
        "--sensor",
        "soft_bubble",
        "--frame",
        "2",
        "--out",
        tmp_path / "o",
    )


def test_a_singular_camera_matrix_is_refused(tmp_path, said):
    path = tmp_path / "k.npz"
    np.savez(path, depth_mm=np.full((3, 140, 175), 80.0, np.float32), K=np.zeros((3, 3)))
    assert "singular" in said("inspect", path)


def test_a_damaged_frame_leaves_the_others_translated(touches, tmp_path, capsys):
    (touches / "touch_1.png").write_bytes((touches / "touch_1.png").read_bytes()[:300])
    out = tmp_path / "out"
    code = run_app(
        build_app(),
        [
            "translate",
            str(touches),
            "--target",
            "gelslim",
            "--sensor",
            "gelsight_mini",
            "--all",
            "--out",
            str(out),
        ],
    )
    assert code == EXIT_USER_ERROR
    frames = json.loads((out / "report.json").read_text())["frames"]
    assert [("problem" in f) for f in frames] == [False, True, False]
    assert "touch_1.png" in frames[1]["problem"]


def test_a_recording_of_another_program_is_not_taken_for_ours(tmp_path, said):
    path = tmp_path / "other.h5"
    with h5py.File(path, "w") as file:
        file["data"] = np.zeros(3)
    assert "other.h5" in said("inspect", path)


def said_by_frame(touches, tmp_path, said):
    return said(
        "translate",
        touches,
        "--target",
        "gelslim",
        "--sensor",
        "gelsight_mini",
        "--frame",
        "2",
        "--out",
        tmp_path / "o",
    )


def write_box_stl(path, side):
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float) * side
    faces = [
        (0, 1, 3),
        (0, 3, 2),
        (4, 6, 7),
        (4, 7, 5),
        (0, 4, 5),
        (0, 5, 1),
        (2, 3, 7),
        (2, 7, 6),
        (0, 2, 6),
        (0, 6, 4),
        (1, 5, 7),
        (1, 7, 3),
    ]
    lines = ["solid box"]
    for face in faces:
        lines += [
            "facet normal 0 0 0",
            "outer loop",
            *("vertex {} {} {}".format(*corners[i]) for i in face),
            "endloop",
            "endfacet",
        ]
    path.write_text("\n".join([*lines, "endsolid box"]))


def test_what_a_refusal_advises_the_command_knows(tmp_path, said, capsys):
    depth = tmp_path / "touch.png"
    cv2.imwrite(str(depth), np.full((140, 175), 770, np.uint16))
    assert "give --depth-unit" in said("inspect", depth)
    assert run_app(build_app(), ["inspect", str(depth), "--depth-unit", "0.1mm"]) in (0, 1)
    assert "name one with --reference" in capsys.readouterr().out
    for command in ("inspect", "translate"):
        run_app(build_app(), [command, "--help"])
        shown = capsys.readouterr().out
        assert all(option in shown for option in ("--depth-unit", "--reference", "--sensor"))


@pytest.mark.parametrize(
    "words",
    [
        ["export", "{}", "--target", "gelslim", "--out", "{}"],
        ["attribute", "{}", "--target", "gelslim", "--json", "{}"],
        ["compare", "other.h5", "--target", "gelslim", "--weights", "touch={}", "--out", "{}"],
    ],
)
def test_no_command_writes_over_what_it_reads(tmp_path, said, words):
    path = tmp_path / "recording.npz"
    path.write_bytes(b"mine")
    assert "this would replace what is read" in said(*(word.format(path) for word in words))
    assert path.read_bytes() == b"mine"


def test_a_table_is_written_again_next_to_the_recording(touches, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    command = [
        "export",
        str(touches),
        "--sensor",
        "gelsight_mini",
        "--target",
        "soft_bubble",
        "--pane",
        "depth",
        "--frames",
        "2",
        "--to",
        "forces.csv",
    ]
    assert [run_app(build_app(), command) for _ in range(2)] == [0, 0]


@pytest.mark.parametrize(
    "words", [["inspect", ""], ["translate", "x.h5", "--target", "digit", "--out", ""]]
)
def test_an_empty_path_is_not_taken_for_the_current_folder(said, words):
    assert "is empty" in said(*words)


def test_a_full_disk_behind_the_output_is_one_sentence():
    command = [sys.executable, "-m", "pipeline", "inspect", str(SAMPLE)]
    with Path("/dev/full").open("wb") as full:
        ended = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert (ended.returncode, ended.stderr) == (
        2,
        "tactoscope: No space left on device: the output\n",
    )


def test_a_closed_stderr_leaves_the_exit_code():
    command = f"exec '{sys.executable}' -m pipeline inspect nowhere.h5 2>&-"
    assert subprocess.run(["sh", "-c", command], check=False).returncode == EXIT_USER_ERROR


def test_an_error_of_a_sensor_translated_to_itself_is_not_said_to_lack_its_frames(said):
    words = said("attribute", SAMPLE, "--target", "gelslim", "--frame", "0")
    assert "the source is gelslim too: choose another --target or --sensor" in words
