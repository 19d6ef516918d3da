"""`tactoscope simulate` as it is typed: what it leaves behind, Ctrl-C, and one sentence for each
mistake.
"""

from __future__ import annotations

import os
import signal

import pytest

from pipeline.cli.main import EXIT_INTERRUPTED, EXIT_USER_ERROR, build_app, run_app
from pipeline.io.inspection.recording_report import inspect_recording
from pipeline.physics.simulation import datasets, shapes

ONE, OTHER = shapes.list_shapes("training")[:2]


@pytest.fixture
def typed(capsys):
    """Run `simulate` with these options; returns its exit code and what it said on stderr."""

    def go(*tokens):
        jobs = () if "--jobs" in tokens else ("--jobs", "1")
        code = run_app(build_app(), ["simulate", *jobs, *(str(t) for t in tokens)])
        return code, capsys.readouterr().err

    return go


def test_each_object_becomes_a_recording_that_passes_every_check(typed, tmp_path):
    out = tmp_path / "set"
    code, said = typed(
        "--sensors", "digit,soft_bubble", "--tools", f"{ONE},{OTHER}", "--poses", 1, "--out", out
    )
    assert code == 0, said
    assert sorted(p.name for p in out.iterdir()) == sorted(f"{name}.h5" for name in (ONE, OTHER))
    report = inspect_recording(out / f"{ONE}.h5")
    assert [check.name for check in report.checks if check.state == "fail"] == []


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_and_sigterm_keep_what_is_finished_and_the_same_command_goes_on(
    typed, tmp_path, monkeypatch, how
):
    out = tmp_path / "one.h5"
    made = datasets.simulate_moment

    def interrupted(plan, index):
        if index == 1:
            os.kill(os.getpid(), how)
        return made(plan, index)

    options = ("--sensors", "digit", "--tools", ONE, "--poses", 4, "--out", out)
    monkeypatch.setattr(datasets, "simulate_moment", interrupted)
    code, said = typed(*options)
    assert code == EXIT_INTERRUPTED
    assert "finished frames are complete" in said
    monkeypatch.setattr(datasets, "simulate_moment", made)
    assert inspect_recording(out).streams[0].n_frames == 2
    assert typed(*options)[0] == 0
    assert inspect_recording(out).streams[0].n_frames == 4


def test_what_is_finished_is_not_made_again(typed, tmp_path):
    options = ("--sensors", "digit", "--tools", ONE, "--poses", 1, "--out", tmp_path / "one.h5")
    assert typed(*options)[0] == 0
    code, said = typed(*options)
    assert code == EXIT_USER_ERROR
    assert "already" in said
    code, said = typed(*options, "--seed", 3)
    assert code == EXIT_USER_ERROR
    assert "a recording of another plan" in said


@pytest.mark.parametrize(
    ("options", "outcome"),
    [
        (("--sensors", "fingertip", "--tools", ONE), "fingertip"),
        (("--sensors", "digit", "--tools", "spoon"), "spoon"),
        (("--sensors", "digit", "--tools", ONE, "--poses", "0"), "--poses"),
        (("--sensors", "digit", "--tools", ONE, "--poses", "1000000000000"), "within 1 and 100000"),
        (("--sensors", "digit", "--tools", ONE, "--seed", "9" * 100), "--seed"),
        (("--sensors", "digit", "--tools", ONE, "--jobs", "0"), "--jobs"),
        (("--sensors", "digit", "--tools", f"{ONE},{OTHER}"), "folder"),
    ],
)
def test_a_mistake_is_one_sentence(typed, tmp_path, options, outcome):
    code, said = typed(*options, "--out", tmp_path / "one.h5")
    assert code == EXIT_USER_ERROR
    lines = [line for line in said.splitlines() if line.startswith("tactoscope: ")]
    assert len(lines) == 1
    assert outcome in lines[0]
    assert "Traceback" not in said
    assert not (tmp_path / "one.h5").exists()
