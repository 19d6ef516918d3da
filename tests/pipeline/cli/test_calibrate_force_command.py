"""`tactoscope calibrate force`: from weighed presses to newtons in report and table."""

from __future__ import annotations

import csv
import json
from contextlib import closing

import numpy as np
import pytest

from pipeline.calibration.force_scale import fit_force_scale, save_force_scale
from pipeline.cli.main import EXIT_USER_ERROR, build_app, run_app
from pipeline.io import open_recording
from tests.pipeline.cli.test_cli import SAMPLE

pytestmark = pytest.mark.usefixtures("shared_results")


def run(*tokens):
    return run_app(build_app(), [str(token) for token in tokens])


def test_weighed_presses_turn_an_unknown_scale_into_newtons(tmp_path, capsys):
    """True forces are tripled, as on a stiffer gel."""
    with closing(open_recording(SAMPLE)) as recording:
        truths = [recording.stream("gelslim").truth(index) for index in (4, 8)]
    true = np.array([-truth.force_n[2] for truth in truths])
    out = tmp_path / "mine.npz"
    table = tmp_path / "table.csv"
    assert (
        run(
            "calibrate",
            "force",
            SAMPLE,
            "--sensor",
            "gelslim",
            "--frames",
            "8,4",
            "--out",
            out,
            "--forces",
            f"{3 * true[1]},{3 * true[0]}",
        )
        == 0
    )
    assert "calibration written" in capsys.readouterr().out
    assert (
        run(
            "export",
            SAMPLE,
            "--target",
            "soft_bubble",
            "--sensor",
            "gelslim",
            "--out",
            table,
            "--frames",
            "4,8",
            "--calibration",
            out,
            "--pane",
            "depth",
        )
        == 0
    )
    rows = list(csv.DictReader(table.read_text(encoding="utf-8").splitlines()))
    assert "frame.uncalibrated_force_n" not in rows[0]
    assert not any(name.startswith("touch") for name in rows[0]), (
        "stages that no row needs are not computed"
    )
    assert [float(row["frame.force_n"]) for row in rows] == pytest.approx(3 * true, rel=0.15)
    assert [float(row["frame.true_force_n"]) for row in rows] == pytest.approx(true)
    capsys.readouterr()
    assert run("inspect", out) == 0
    assert "force of gelslim" in capsys.readouterr().out


def test_shear_of_a_dragged_object_stands_next_to_its_force(tmp_path):
    recording = tmp_path / "dragged.h5"
    table = tmp_path / "table.csv"
    scale = tmp_path / "scale.npz"
    assert (
        run(
            "simulate",
            "--sensors",
            "gelslim",
            "--tools",
            "hexagon",
            "--poses",
            "2",
            "--drag-mm",
            "0.3",
            "--jobs",
            "1",
            "--out",
            recording,
        )
        == 0
    )
    save_force_scale(fit_force_scale("gelslim", [1.0, 4.0], [3.0, 12.0]), scale)
    tables = []
    for options in ((), ("--calibration", scale)):
        assert (
            run(
                "export",
                recording,
                "--target",
                "soft_bubble",
                "--sensor",
                "gelslim",
                "--pane",
                "depth",
                "--out",
                table,
                *options,
            )
            == 0
        )
        tables.append(list(csv.DictReader(table.read_text(encoding="utf-8").splitlines())))
    with closing(open_recording(recording)) as opened:
        forces = [opened.stream("gelslim").truth(index).force_n for index in (0, 1)]
    for plain, scaled, force in zip(*tables, forces, strict=True):
        shear = float(plain["frame.uncalibrated_shear_n"])
        assert shear == pytest.approx(float(plain["frame.true_shear_n"]), rel=0.25)
        assert float(plain["frame.true_shear_n"]) == pytest.approx(np.hypot(*force[:2]))
        assert float(scaled["frame.shear_n"]) == pytest.approx(3 * shear)
        turn = float(plain["frame.shear_direction_deg"]) - np.degrees(
            np.arctan2(force[1], force[0])
        )
        assert abs((turn + 180) % 360 - 180) < 5


def test_the_report_says_that_a_scale_is_not_known(tmp_path, capsys):
    assert (
        run(
            "translate",
            SAMPLE,
            "--target",
            "soft_bubble",
            "--sensor",
            "gelslim",
            "--force",
            "--out",
            tmp_path / "o",
        )
        == 0
    )
    assert "its scale is not known" in " ".join(capsys.readouterr().out.split())
    report = json.loads((tmp_path / "o" / "report.json").read_text(encoding="utf-8"))
    assert report["frames"][0]["metrics"]["frame.uncalibrated_force_n"] > 0
    assert report["metrics"]["frame.uncalibrated_force_n"]["unit"] == "N"


@pytest.mark.parametrize(
    ("options", "part"),
    [
        (("--frames", "4,8", "--forces", "1.0"), "1 values for 2 frames"),
        (("--frames", "4,8", "--forces", "a,b"), "numbers in N"),
        (("--frames", "4,8", "--forces", "1,0"), "above 0 N"),
        (("--frames", "4,99", "--forces", "1,2"), "99"),
    ],
)
def test_a_mistake_is_one_sentence(options, part, tmp_path, capsys):
    out = tmp_path / "o.npz"
    assert (
        run("calibrate", "force", SAMPLE, "--sensor", "gelslim", "--out", out, *options)
        == EXIT_USER_ERROR
    )
    assert part in capsys.readouterr().err
    assert not out.exists()


def test_weighings_of_another_sensor_are_refused(tmp_path, capsys):
    out = tmp_path / "bubble.npz"
    assert (
        run(
            "calibrate", "force", SAMPLE, "--sensor", "soft_bubble", "--frames", "4,8", "--out", out
        )
        == 0
    )
    code = run(
        "translate",
        SAMPLE,
        "--target",
        "soft_bubble",
        "--sensor",
        "gelslim",
        "--calibration",
        out,
        "--out",
        tmp_path / "t",
    )
    assert code == EXIT_USER_ERROR
    assert "the weighings are of soft_bubble, not of gelslim" in capsys.readouterr().err
