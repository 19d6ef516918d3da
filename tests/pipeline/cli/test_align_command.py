"""`tactoscope align` as it is typed, and an alignment file where a recording is translated or a
session kept.
"""

from __future__ import annotations

import tomllib

import numpy as np
import pytest

from app.session.state import Session, load_session, save_session
from pipeline.cli.align import parse_frames
from pipeline.cli.main import EXIT_USER_ERROR, build_app, run_app
from pipeline.core.errors import SettingProblem
from pipeline.core.geometry import rigid
from pipeline.sensors.alignment import AlignmentFile, load_alignment, save_alignment
from pipeline.translation.alignment.nudge import nudge
from pipeline.translation.translate import Request, open_translation
from sample_data import make_alignments
from sample_data.make_samples import RECORDINGS_FOLDER

pytestmark = pytest.mark.usefixtures("shared_results")
SAMPLE = RECORDINGS_FOLDER / "digit_gelslim.h5"
EXACT = load_alignment(
    make_alignments.alignment_path("digit", "gelslim"), source="digit", target="gelslim"
)
SAME = 1e-9  # mm and entries of a rotation: what a file rounds away, composed


@pytest.fixture
def typed(capsys):
    """Run `align` with these words.

    Returns its exit code, what it printed and what it said on stderr.
    """

    def go(*tokens):
        code = run_app(build_app(), ["align", *(str(t) for t in tokens)])
        said = capsys.readouterr()
        return code, said.out, said.err

    return go


@pytest.fixture
def off(tmp_path):
    """A file that is 1 mm and 2 degrees off."""
    moved = nudge(EXACT.alignment, "x", 1.0, pivot_mm=np.array([0.0, 0.0, 20.0]))
    moved = nudge(moved, "rz", 2.0, pivot_mm=np.array([0.0, 0.0, 20.0]))
    path = tmp_path / "off.toml"
    save_alignment(path, AlignmentFile(alignment=moved, source="digit", target="gelslim"))
    return path


def test_scores_are_a_table_of_frames_and_of_axes(typed):
    code, out, _ = typed("score", SAMPLE, "--target", "gelslim", "--truth")
    assert code == 0
    assert "mask IoU" in out
    rows = [line.replace("┃", "│").split("│") for line in out.splitlines() if "│" in line]
    assert [row[1].strip() for row in rows] == [
        "2",
        "3",
        "median",
        "x (mm)",
        "y (mm)",
        "z (mm)",
        "rx (deg)",
        "ry (deg)",
        "rz (deg)",
    ]
    assert float(rows[0][2]) > 0.9


def test_refining_writes_an_alignment_nearer_to_the_exact_one_and_prints_the_change(
    typed, off, tmp_path
):
    out_file = tmp_path / "refined.toml"
    refine = (
        "refine",
        SAMPLE,
        "--target",
        "gelslim",
        "--alignment",
        off,
        "--truth",
        "--hold-out",
        "0.5",
    )
    code, out, _ = typed(*refine, "--out", out_file)
    assert code == 0
    assert "held out, after" in out
    assert "predicted standard deviation" in out
    moved_mm = [float(v) for v in out.split("moved the contact by (")[1].split(")")[0].split(",")]
    assert 0.5 < np.linalg.norm(moved_mm) < 2.0  # the file was 1 mm off
    found = load_alignment(out_file, source="digit", target="gelslim")
    assert "digit_gelslim.h5" in found.origin
    left = found.alignment.target_from_source @ rigid.invert(EXACT.alignment.target_from_source)
    middle = np.array([0.0, 0.0, 20.0])
    # mm, of 1 mm: one touch, seen on both gels
    assert np.linalg.norm(rigid.apply(left, middle) - middle) < 0.2
    code, _, err = typed(*refine, "--out", out_file)
    assert code == EXIT_USER_ERROR
    assert "exists already and is kept" in err


@pytest.mark.parametrize(
    ("tokens", "fact"),
    [
        (("score", SAMPLE, "--target", "soft_bubble"), "soft_bubble recorded no frame 0 here"),
        (
            ("score", SAMPLE, "--target", "gelslim", "--frames", "0-1"),
            "none of the 2 frames has contact on both",
        ),
        (
            ("score", SAMPLE, "--target", "gelslim", "--frames", "9"),
            "no frame 9; the recording has frames 0 to 5",
        ),
        (
            ("score", SAMPLE, "--target", "gelslim", "--frames", "a"),
            "numbers and ranges such as 0,3-7",
        ),
        (("refine", SAMPLE, "--target", "gelslim", "--out", "x.txt"), "ends in .toml"),
        (
            ("refine", SAMPLE, "--target", "gelslim", "--out", "x.toml", "--hold-out", "1"),
            "below 1, got 1",
        ),
    ],
)
def test_a_mistake_is_one_sentence(typed, tokens, fact):
    code, _, err = typed(*tokens)
    assert code == EXIT_USER_ERROR
    assert fact in err
    assert len(err.strip().splitlines()) == 1


def test_an_alignment_of_other_sensors_is_refused(typed, off):
    code, _, err = typed(
        "score", SAMPLE, "--sensor", "gelslim", "--target", "digit", "--alignment", off
    )
    assert code == EXIT_USER_ERROR
    assert "swap source and target" in err


def test_a_translation_uses_the_alignment_file_and_a_session_stores_it(off, tmp_path):
    request = Request(recording=SAMPLE, source="digit", target="gelslim", alignment=off)
    opened = open_translation(request)
    wanted = load_alignment(off, source="digit", target="gelslim").alignment.target_from_source
    np.testing.assert_allclose(opened.alignment.target_from_source, wanted, atol=SAME)
    opened.recording.close()
    session = tmp_path / "kept.touch.json"
    save_session(Session(recording=SAMPLE, alignment=off), session)
    assert load_session(session).alignment.resolve() == off.resolve()


@pytest.mark.parametrize(("recording", "source", "target"), make_alignments.RECORDED_PAIRS)
def test_the_samples_alignments_are_those_of_their_recordings(recording, source, target):
    path = make_alignments.alignment_path(source, target)
    assert tomllib.loads(path.read_text(encoding="utf-8"))["from"].startswith("exact")
    kept = load_alignment(path, source=source, target=target).alignment
    known = make_alignments.read_exact_alignment(recording, source, target).alignment
    np.testing.assert_allclose(kept.target_from_source, known.target_from_source, atol=SAME)


def test_frames_are_numbers_and_ranges():
    assert parse_frames("", 3) == [0, 1, 2]
    assert parse_frames("4, 0-2,1", 6) == [0, 1, 2, 4]
    with pytest.raises(SettingProblem, match="no frame 6"):
        parse_frames("2-6", 6)


def test_fit_writes_an_alignment_without_an_initial_one(typed, tmp_path):
    out = tmp_path / "fitted.toml"
    recording = SAMPLE.with_name("grasps_lines_120.h5")
    words = ("--sensor", "gelslim", "--target", "soft_bubble", "--truth", "--out", out)
    code, said, error = typed("fit", recording, *words)
    assert code == 0, error
    assert "held out" in said
    assert "standard deviation of 0." in said
    fitted = load_alignment(
        out, source="gelslim", target="soft_bubble"
    ).alignment.target_from_source
    # how the sample's bubble is turned; 47 mm lie between the two cameras
    exact = np.diag([-1.0, -1.0, 1.0])
    off = np.degrees(np.arccos(np.clip((np.trace(fitted[:3, :3].T @ exact) - 1) / 2, -1, 1)))
    assert off < 1.0
    assert fitted[:3, 3] == pytest.approx((0.0, 0.0, 47.0), abs=0.3)


def test_fit_names_the_directions_that_touches_of_one_curve_do_not_determine(typed, tmp_path):
    words = ("--sensor", "gelslim", "--target", "soft_bubble", "--out", tmp_path / "fitted.toml")
    code, said, error = typed("fit", SAMPLE.with_name("grasps_curve.h5"), *words)
    assert code == 0, error
    assert "not observable" in said
