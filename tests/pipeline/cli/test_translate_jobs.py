"""Frames that several processes translate at once."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from pipeline.cli import translate
from pipeline.cli.main import EXIT_USER_ERROR, build_app, run_app

UNTOUCHED = Path(__file__).parents[3] / "sample_data" / "recordings" / "no_contact.h5"


@pytest.mark.timeout(600)
def test_frames_of_two_processes_are_those_of_one(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    shutil.copy(UNTOUCHED, "still.h5")
    common = ["translate", "still.h5", "--target", "digit", "--sensor", "gelslim", "--all"]
    assert run_app(build_app(), [*common, "--jobs", "2", "--out", "two"]) == 0
    assert "finished by an earlier run" not in capsys.readouterr().out
    assert run_app(build_app(), [*common, "--jobs", "1", "--out", "one"]) == 0
    frames = sorted(path.name for path in Path("one").glob("frame_*"))
    assert len(frames) > 1
    assert frames == sorted(path.name for path in Path("two").glob("frame_*"))
    for name in frames:
        one, two = (np.load(Path(where, name, "stages.npz")) for where in ("one", "two"))
        assert one.files == two.files
        assert all(one[key].tobytes() == two[key].tobytes() for key in one.files)
    assert run_app(build_app(), [*common, "--jobs", "1", "--out", "two"]) == 0
    assert "finished by an earlier run" in capsys.readouterr().out


def test_few_frames_start_no_further_process(monkeypatch):
    monkeypatch.setattr("os.cpu_count", lambda: 4)
    assert [translate._choose_workers(0, n) for n in (1, 23, 48, 1000)] == [0, 0, 2, 4]
    assert [translate._choose_workers(3, n) for n in (1, 2, 1000)] == [1, 2, 3]


@pytest.mark.parametrize(
    "more", [[], ["--all", "--follow"], ["--all", "--scheduler", "tcp://127.0.0.1:1"]]
)
def test_jobs_go_with_all_frames_alone(more, capsys):
    words = ["translate", str(UNTOUCHED), "--target", "digit", "--out", "x", "--jobs", "2", *more]
    assert run_app(build_app(), words) == EXIT_USER_ERROR
    assert "--jobs share single frames" in capsys.readouterr().err
