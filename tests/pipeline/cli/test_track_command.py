"""`tactoscope track` on the sample recording."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest

from pipeline.cli.main import build_app, run_app
from pipeline.core.geometry.meshes import load_mesh

SAMPLE = "sample_data/recordings/first_touch.h5"


def run(*tokens):
    return run_app(build_app(), [str(token) for token in tokens])


def test_motion_and_surface_of_the_sample_are_written(tmp_path, capsys):
    assert (
        run("track", SAMPLE, "--sensor", "gelslim", "--frames", "6-8", "--out", tmp_path / "out")
        == 0
    )
    summary = json.loads((tmp_path / "out" / "track.json").read_text())
    assert (summary["frames"], summary["lost"], summary["parts"]) == (3, 0, 1)
    assert summary["error"]["path_mm"] > 1.0
    assert summary["error"]["drift_mm"] < 0.1
    assert summary["error"]["drift_deg"] < 1.0
    assert len(load_mesh(tmp_path / "out" / "patch.ply", unit="mm").triangles) > 1000
    assert "3" in capsys.readouterr().out
    assert len((tmp_path / "out" / "track.csv").read_text().splitlines()) == 4


@pytest.mark.parametrize(
    ("option", "value", "named"), [("--frames", "90", "90"), ("--target", "nobody", "nobody")]
)
def test_a_wrong_option_is_named(tmp_path, capsys, option, value, named):
    assert run("track", SAMPLE, "--sensor", "gelslim", option, value, "--out", tmp_path) == 2
    assert named in capsys.readouterr().err


def test_pictures_of_an_unnamed_sensor_ask_for_it(tmp_path, capsys):
    pictures = tmp_path / "pictures"
    pictures.mkdir()
    for k in range(2):
        cv2.imwrite(str(pictures / f"{k}.png"), np.full((68, 90, 3), 90, np.uint8))
    assert run("track", pictures, "--out", tmp_path / "out") == 2
    error = capsys.readouterr().err
    assert "--sensor" in error
    assert str(pictures) in error
    assert not (tmp_path / "out").exists()
