"""Frames that several processes translate at once."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from pipeline.cli import translate
from pipeline.cli.main import EXIT_USER_ERROR, build_app, run_app
from pipeline.translation.following import FROM_REST
from pipeline.translation.translate import Translation

RECORDINGS = Path(__file__).parents[3] / "sample_data" / "recordings"
UNTOUCHED = RECORDINGS / "no_contact.h5"


@pytest.mark.timeout(600)
@pytest.mark.parametrize("follow", [False, True])
def test_frames_of_two_processes_are_those_of_one(follow, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(translate, "_FOLLOWED_FRAMES", 2)
    recording = RECORDINGS / ("digit_gelslim.h5" if follow else "no_contact.h5")
    shutil.copy(recording, "some.h5")
    common = ["translate", "some.h5", "--target", "gelslim" if follow else "digit", "--all"]
    common += ["--sensor", "digit" if follow else "gelslim", "--no-sheets"]
    common += [] if follow else ["--no-follow"]
    assert run_app(build_app(), [*common, "--jobs", "2", "--out", "two"]) == 0
    assert "finished by an earlier run" not in capsys.readouterr().out
    followed = []
    evaluate = Translation.evaluate

    def record(self, frame, *given, start=FROM_REST, **more):
        followed.extend([frame.index] if start.pose is not None else [])
        return evaluate(self, frame, *given, start=start, **more)

    monkeypatch.setattr(Translation, "evaluate", record)
    assert run_app(build_app(), [*common, "--jobs", "1", "--out", "one"]) == 0
    assert followed == ([3] if follow else []), "frame 2 has a pose as well, and begins a run"
    frames = sorted(path.name for path in Path("one").glob("frame_*"))
    assert len(frames) > 1
    assert frames == sorted(path.name for path in Path("two").glob("frame_*"))
    for name in frames:
        one, two = (np.load(Path(where, name, "stages.npz")) for where in ("one", "two"))
        assert one.files == two.files
        assert all(one[key].tobytes() == two[key].tobytes() for key in one.files)
    one, two = (json.loads(Path(where, "report.json").read_text()) for where in ("one", "two"))
    assert [f["metrics"] for f in one["frames"]] == [f["metrics"] for f in two["frames"]]
    if follow:
        return
    assert run_app(build_app(), [*common, "--jobs", "2", "--out", "two"]) == 0
    assert f"{len(frames)} of them were finished by an earlier run" in capsys.readouterr().out


def test_few_frames_start_no_further_process(monkeypatch):
    monkeypatch.setattr("os.cpu_count", lambda: 4)
    assert [translate._choose_workers(0, n) for n in (1, 23, 48, 1000)] == [0, 0, 2, 4]
    assert [translate._choose_workers(3, n) for n in (1, 2, 1000)] == [1, 2, 3]


def test_frames_in_a_row_are_shared_evenly_by_two_processes():
    lengths = {n: translate._choose_length(n) for n in (1, 24, 25, 60, 200)}
    assert lengths == {1: 1, 24: 24, 25: 13, 60: 15, 200: 20}


def test_jobs_go_with_all_frames_alone(capsys):
    words = ["translate", str(UNTOUCHED), "--target", "digit", "--out", "x", "--jobs", "2"]
    assert run_app(build_app(), words) == EXIT_USER_ERROR
    assert "--jobs share frames" in capsys.readouterr().err
