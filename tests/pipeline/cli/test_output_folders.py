"""A place that cannot be written is refused before any work.

What is written together is written whole or not at all.

A frame that cannot be read is named once, and the others are written.
"""

from __future__ import annotations

import os
import resource
from pathlib import Path

import h5py
import pytest

from pipeline.cli.main import EXIT_USER_ERROR, build_app, run_app
from pipeline.core.errors import FileProblem
from pipeline.core.files import write_together
from pipeline.translation.reports.video import count_frames

SAMPLE = Path(__file__).parents[3] / "sample_data" / "recordings" / "first_touch.h5"
NOWHERE = "/proc/x"
_ONE = (str(SAMPLE), "--target", "soft_bubble", "--sensor", "gelslim")


def write_damaged(path, indices):
    """Write the sample with frames that do not unpack."""
    content = bytearray(SAMPLE.read_bytes())
    with h5py.File(SAMPLE) as file:
        chunks = [file["streams/gelslim/frames"].id.get_chunk_info(index) for index in indices]
    for chunk in chunks:
        content[chunk.byte_offset : chunk.byte_offset + chunk.size] = bytes(chunk.size)
    path.write_bytes(content)


@pytest.mark.parametrize(
    ("words", "first_work"),
    [
        (("translate", *_ONE, "--out", NOWHERE), "pipeline.cli.translate._select_frame"),
        (("compare", *_ONE, "--out", NOWHERE), "pipeline.cli.compare.compare_methods"),
        (
            ("attribute", *_ONE, "--json", f"{NOWHERE}/shares.json"),
            "pipeline.cli.attribute.attribute_error",
        ),
        (
            ("track", *_ONE[:1], "--sensor", "gelslim", "--out", NOWHERE),
            "pipeline.cli.track.track_recording",
        ),
        (
            (
                "simulate",
                "--sensors",
                "gelslim",
                "--tools",
                "square",
                "--out",
                NOWHERE,
                "--jobs",
                "1",
            ),
            "pipeline.lab.recorder.record_plan",
        ),
    ],
)
@pytest.mark.skipif(os.access(NOWHERE, os.F_OK), reason="this place exists here")
def test_an_output_that_cannot_be_written_is_refused_before_any_work(
    words, first_work, monkeypatch, capsys
):
    monkeypatch.setattr(first_work, lambda *_, **__: pytest.fail("work was done first"))
    assert run_app(build_app(), list(words)) == EXIT_USER_ERROR
    assert "is not writable" in capsys.readouterr().err


@pytest.mark.parametrize(
    "words",
    [
        ("translate", "--target", "soft_bubble", "--out", "o"),
        ("track", "--out", "o"),
        ("compare", "--target", "soft_bubble", "--out", "o/methods.png"),
        ("attribute", "--target", "soft_bubble", "--json", "o/shares.json"),
        ("export", "--target", "soft_bubble", "--pane", "depth", "--to", "o/forces.csv"),
        ("bundle", "--target", "soft_bubble", "--out", "o/bundle"),
    ],
)
def test_frames_that_cannot_be_read_leave_no_folder(words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    write_damaged(Path("damaged.h5"), range(16))
    assert (
        run_app(build_app(), [words[0], "damaged.h5", *words[1:], "--sensor", "gelslim"])
        == EXIT_USER_ERROR
    )
    assert "its frames are damaged" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["damaged.h5"]


@pytest.mark.parametrize(
    ("words", "written", "rows"),
    [
        (
            ("track", "--out", "o"),
            "o/track.csv",
            [("6", "tracked"), ("7", "lost"), ("8", "tracked")],
        ),
        (
            ("export", "--target", "soft_bubble", "--pane", "depth", "--to", "o.csv"),
            "o.csv",
            [("6", "0.6"), ("8", "0.8")],
        ),
        (("export", "--target", "soft_bubble", "--pane", "depth", "--to", "o.avi"), "o.avi", 2),
    ],
)
def test_one_frame_that_cannot_be_read_does_not_cost_the_others(
    words, written, rows, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    write_damaged(Path("damaged.h5"), [7])
    options = ("--sensor", "gelslim", "--frames", "6-8")
    assert run_app(build_app(), [words[0], "damaged.h5", *words[1:], *options]) == EXIT_USER_ERROR
    assert capsys.readouterr().err.count("frame 7: ") == 1
    if written.endswith(".avi"):
        assert count_frames(Path(written)) == rows
    else:
        lines = Path(written).read_text().splitlines()[1:]
        assert [tuple(line.split(",")[:2]) for line in lines] == rows


def test_a_full_disk_leaves_every_file_as_it_was(tmp_path):
    table = tmp_path / "track.csv"
    surface = tmp_path / "patch.ply"
    write_together(tmp_path, {table.name: b"old", surface.name: b"old"}, "the track", Path.iterdir)
    limit, most = resource.getrlimit(resource.RLIMIT_FSIZE)
    # a file of this size is where the disk is full
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, most))
    try:
        with pytest.raises(FileProblem, match="cannot write the track"):
            write_together(
                tmp_path,
                {table.name: b"new", surface.name: bytes(40_000)},
                "the track",
                Path.iterdir,
            )
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, most))
    assert (table.read_bytes(), surface.read_bytes()) == (b"old", b"old")
    assert {path.name for path in tmp_path.iterdir()} == {"track.csv", "patch.ply"}
