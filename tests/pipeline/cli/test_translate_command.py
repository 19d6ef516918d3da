"""`tactoscope translate --all`: finished frames are not computed again, and a bad frame does not
end the run.
"""

from __future__ import annotations

import json
import tracemalloc
from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from pipeline.cli import translate
from pipeline.cli.main import EXIT_UNEXPECTED, build_app, run_app
from pipeline.stages.metrics.stage_metrics import UNCALIBRATED_FORCE
from pipeline.translation.reports import report
from pipeline.translation.translate import Translation
from tests.pipeline.cli.conftest import dent, save

RESUMED = "were finished by an earlier run and are kept"


@pytest.fixture(autouse=True)
def blank_sheets(monkeypatch):
    """Sheets take longest to draw, and nothing here looks at one."""
    monkeypatch.setattr(
        "pipeline.translation.reports.sheet.write_sheet",
        lambda path, *_: path.write_bytes(b"a sheet"),
    )


@pytest.fixture
def typed(touches, tmp_path, capsys):
    """Translate the touches with these words more; returns exit code, stdout and stderr."""

    def go(*more):
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
        code = run_app(build_app(), [str(a) for a in (*asked, *(more or ("--all",)))])
        said = capsys.readouterr()
        return (
            code,
            said.out,
            "".join(line for line in said.err.splitlines(keepends=True) if "tactoscope: " in line),
        )

    return go


def times(out):
    """When every frame's arrays were written, and what the report says."""
    return {p.parent.name: p.stat().st_mtime_ns for p in out.glob("frame_*/stages.npz")}


def frames(out):
    return json.loads((out / "report.json").read_text())["frames"]


def test_a_second_run_keeps_finished_frames_and_says_so(typed, tmp_path):
    typed()
    before = times(tmp_path / "out")
    report = frames(tmp_path / "out")
    code, out, _ = typed()
    assert code == 0
    assert f"3 of them {RESUMED}" in out
    assert times(tmp_path / "out") == before
    assert frames(tmp_path / "out") == report


def test_force_is_computed_on_request_alone_and_a_skip_is_said(typed, tmp_path, monkeypatch):
    calls = []
    measure = translate.measure_force
    monkeypatch.setattr(
        translate, "measure_force", lambda *given: calls.append(1) or measure(*given)
    )
    _, out, _ = typed("--frame", "2")
    assert "force: skipped" in out
    assert not calls
    assert UNCALIBRATED_FORCE not in frames(tmp_path / "out")[0]["metrics"]
    _, out, _ = typed("--frame", "2", "--force")
    assert "skipped" not in out.split("normal force", 1)[1]
    assert len(calls) == 1
    assert frames(tmp_path / "out")[0]["metrics"][UNCALIBRATED_FORCE] > 0.0
    typed("--frame", "2", "--force")
    assert len(calls) == 1, "kept"
    monkeypatch.setattr(report, "FORCE", replace(report.FORCE, version=report.FORCE.version + 1))
    typed("--frame", "2", "--force")
    assert len(calls) == 2, "the force is by another version"


def test_a_fallback_is_named_when_computed_and_when_resumed(typed):
    for _ in range(2):
        _, out, _ = typed("--frame", "1", "--method", "depth=depth_anything")
        said = " ".join(out.split())
        assert (
            "fallback used in 1 of 1 frames: depth: physics: no network for this sensor; no "
            "weights of" in said
        )
        assert out.count("warning: depth:") == 1


def test_warnings_that_differ_by_a_number_are_listed_once_with_the_first_frames():
    def report(index, *warnings):
        return SimpleNamespace(index=index, results={"pose": SimpleNamespace(warnings=warnings)})

    lines = translate.list_warnings(
        [report(0, "10 poses fit"), report(1, "12 poses fit", "slides"), report(4, "12 poses fit")]
    )
    assert lines == [
        "warning: pose: 10 poses fit (3 frames: 0, 1, 4; numbers of frame 0)",
        "warning: pose: slides (frame 1)",
    ]


def test_an_interrupted_run_continues(typed, tmp_path, monkeypatch):
    whole = translate.write_frame
    written = []

    def until_killed(*args, **options):
        if len(written) == 2:
            raise KeyboardInterrupt
        written.append(whole(*args, **options))

    monkeypatch.setattr(translate, "write_frame", until_killed)
    assert typed()[0] == 130
    monkeypatch.setattr(translate, "write_frame", whole)
    before = times(tmp_path / "out")
    code, out, _ = typed()
    assert code == 0
    assert f"2 of them {RESUMED}" in out
    after = times(tmp_path / "out")
    assert [name for name in after if after[name] == before.get(name)] == [
        "frame_0000",
        "frame_0001",
    ]
    assert [f["index"] for f in frames(tmp_path / "out")] == [0, 1, 2]


@pytest.mark.parametrize(
    "changed",
    [
        "a setting",
        "the picture",
        "the reference",
        "the sheet is empty",
        "the sheet is cut",
        "64 bytes are zeroed",
        "the arrays are cut short",
    ],
)
def test_a_frame_with_other_inputs_or_incomplete_files_is_computed_again(
    changed, typed, touches, tmp_path
):
    typed("--frame", "2")
    before = times(tmp_path / "out")
    more = ("--frame", "2")
    frame = tmp_path / "out" / "frame_0002"
    match changed:
        case "a setting":
            more = (*more, "--set", "target_depth.jump_mm=2")
        case "the picture":
            save(touches / "touch_2.png", dent(0.5))
        case "the reference":
            picture = cv2.imread(str(touches / "background.png"))
            cv2.imwrite(
                str(touches / "background.png"), np.where(picture < 255, picture + 1, picture)
            )
        case "the sheet is empty":
            (frame / "sheet.png").write_bytes(b"")
        case "the sheet is cut":
            (frame / "sheet.png").write_bytes((frame / "sheet.png").read_bytes()[:3])
        case "64 bytes are zeroed":
            with (frame / "stages.npz").open("r+b") as file:
                file.seek(1000)
                file.write(bytes(64))
        case _:
            (frame / "stages.npz").write_bytes((frame / "stages.npz").read_bytes()[:5000])
    code, out, _ = typed(*more)
    assert code == 0
    assert RESUMED not in out
    assert times(tmp_path / "out") != before


def test_frames_without_sheets_are_kept_and_made_again_where_sheets_are_wanted(typed, tmp_path):
    typed("--all", "--no-sheets")
    assert not list((tmp_path / "out").glob("*/sheet.png"))
    _, out, _ = typed("--all", "--no-sheets")
    assert f"3 of them {RESUMED}" in out
    _, out, _ = typed()
    assert RESUMED not in out
    assert len(list((tmp_path / "out").glob("*/sheet.png"))) == 3
    _, out, _ = typed("--all", "--no-sheets")
    assert f"3 of them {RESUMED}" in out, "a sheet more does no harm"


def test_a_frame_folder_with_other_files_stays(typed, tmp_path):
    typed("--frame", "2")
    note = tmp_path / "out" / "frame_0002" / "note.txt"
    note.write_text("mine")
    code, _, err = typed("--frame", "2", "--set", "target_depth.jump_mm=2")
    assert code == 2
    assert "holds other files ('note.txt')" in err
    assert note.read_text() == "mine"


def test_a_recording_is_never_the_output(touches, capsys):
    presses = touches.parent / "presses"
    presses.mkdir()
    touches.rename(presses / "frame_0000")
    before = sorted(path.name for path in presses.rglob("*"))
    words = ["--target", "gelslim", "--sensor", "gelsight_mini", "--all", "--out", str(presses)]
    for recording in (presses, presses / "frame_0000"):
        assert run_app(build_app(), ["translate", str(recording), *words]) == 2, capsys.readouterr()
        assert set(before) <= {path.name for path in presses.rglob("*")}


def test_following_continues_after_frames_of_an_earlier_run(tmp_path, capsys):
    """What follows such a frame comes out as in one go, from its pose and membrane: the same
    arrays, bit by bit.
    """
    from sample_data.make_samples import RECORDINGS_FOLDER

    asked = [
        "translate",
        str(RECORDINGS_FOLDER / "digit_gelslim.h5"),
        *("--target", "soft_bubble", "--route", "t2d2", "--all", "--no-sheets"),
        "--out",
    ]
    assert run_app(build_app(), [*asked, str(tmp_path / "once")]) == 0, capsys.readouterr().err
    assert run_app(build_app(), [*asked, str(tmp_path / "again")]) == 0
    for index in (3, 4):  # both after a touch with a pose
        (tmp_path / "again" / f"frame_{index:04d}" / "frame.json").write_text("{}")
    assert run_app(build_app(), [*asked, str(tmp_path / "again")]) == 0
    assert f"4 of them {RESUMED}" in capsys.readouterr().out
    with (
        np.load(tmp_path / "once" / "frame_0003" / "stages.npz") as once,
        np.load(tmp_path / "again" / "frame_0003" / "stages.npz") as again,
    ):
        assert sorted(once) == sorted(again)
        assert "pose.sensor_from_object" in once
        assert all(once[name].tobytes() == again[name].tobytes() for name in once)


def test_memory_does_not_grow_with_the_frames(typed, touches, monkeypatch):
    """Bytes held after each frame: in the last third of the run as many as before, when all
    caches are full.
    """
    n_frames = 24
    held = []
    for i in range(3, n_frames):
        save(touches / f"touch_{i}.png", dent(0.3 + 0.005 * i, seed=i))
    monkeypatch.setattr(
        translate, "write_frame", lambda *_, **__: held.append(tracemalloc.get_traced_memory()[0])
    )
    monkeypatch.setattr(translate, "CACHE_BYTES", 8_000_000)
    tracemalloc.start()
    try:
        assert typed()[0] == 0
    finally:
        tracemalloc.stop()
    assert len(held) == n_frames
    # The arrays of 8 frames are 16 MB; how much of a frame a full cache still holds varies by a
    # quarter of one.
    assert max(held[16:]) < max(held[8:16]) + 1_000_000


def test_whatever_one_frame_raises_the_others_are_translated(typed, tmp_path, monkeypatch, log):
    whole = Translation.compute_metrics_against

    def sometimes(self, results, *rest):
        if results["depth"].output.contact.any():
            raise ZeroDivisionError("a frame\nthat nobody foresaw")
        return whole(self, results, *rest)

    monkeypatch.setattr(Translation, "compute_metrics_against", sometimes)
    code, out, err = typed()
    assert code == EXIT_UNEXPECTED
    assert "1 of 3 frames written" in out
    assert [line.partition(":")[2].strip() for line in err.splitlines()] == [
        f"frame {i}: unexpected error (ZeroDivisionError: a frame); the details are in '{log}'"
        for i in (1, 2)
    ]
    assert [("problem" in f) for f in frames(tmp_path / "out")] == [False, True, True]
    assert log.read_text().count("ZeroDivisionError: a frame") == 2
    assert "in sometimes" in log.read_text()


def test_an_error_outside_the_frames_is_one_sentence_with_its_details_in_a_file(
    typed, monkeypatch, log
):
    monkeypatch.setattr(translate, "write_report", lambda *_args: {}["key"])
    code, _, err = typed()
    assert code == EXIT_UNEXPECTED
    assert err == (f"tactoscope: unexpected error (KeyError: 'key'); the details are in '{log}'\n")
    assert "Traceback" in log.read_text()


def test_if_the_log_cannot_be_written_the_details_go_to_another_folder(
    typed, monkeypatch, tmp_path
):
    (tmp_path / "state").write_text("a file")
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "temporary"))
    monkeypatch.setattr(translate, "print_stage_table", lambda *_args: {}["key"])
    code, _, err = typed()
    assert code == EXIT_UNEXPECTED
    assert str(tmp_path / "temporary" / "tactoscope.log") in err
    assert "KeyError" in (tmp_path / "temporary" / "tactoscope.log").read_text()
