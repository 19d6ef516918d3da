"""A place that cannot be written is refused before any work; what is written together is written whole or not at all."""

from __future__ import annotations

import os
import resource
from pathlib import Path

import h5py
import pytest

from pipeline.base.errors import FileProblem
from pipeline.base.files import write_together
from pipeline.cli.main import EXIT_USER_ERROR, build_app, run_app

SAMPLE = Path(__file__).parents[3] / "sample_data" / "recordings" / "first_touch.h5"
NOWHERE = "/proc/x"
_ONE = (str(SAMPLE), "--target", "soft_bubble", "--sensor", "gelslim")


@pytest.mark.parametrize(
    ("words", "first_work"),
    [
        (("translate", *_ONE, "--out", NOWHERE), "pipeline.cli.translate._select_frame"),
        (("compare", *_ONE, "--out", NOWHERE), "pipeline.cli.compare.compare_methods"),
        (("attribute", *_ONE, "--json", f"{NOWHERE}/shares.json"), "pipeline.cli.attribute.attribute_error"),
        (("track", *_ONE[:1], "--sensor", "gelslim", "--out", NOWHERE), "pipeline.cli.track.track_recording"),
        (("simulate", "--sensors", "gelslim", "--tools", "square", "--out", NOWHERE, "--jobs", "1"),
         "pipeline.simulation.recorder.record_plan"),
    ],
)  # fmt: skip
@pytest.mark.skipif(os.access(NOWHERE, os.F_OK), reason="this place exists here")
def test_an_output_that_cannot_be_written_is_refused_before_any_work(words, first_work, monkeypatch, capsys):
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
    content = bytearray(SAMPLE.read_bytes())
    with h5py.File(SAMPLE) as file:  # chunks that do not unpack
        images = file["streams/gelslim/frames"].id
        chunks = [images.get_chunk_info(index) for index in range(images.get_num_chunks())]
    for chunk in chunks:
        content[chunk.byte_offset : chunk.byte_offset + chunk.size] = bytes(chunk.size)
    Path("damaged.h5").write_bytes(content)
    assert run_app(build_app(), [words[0], "damaged.h5", *words[1:], "--sensor", "gelslim"]) == EXIT_USER_ERROR
    assert "its frames are damaged" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["damaged.h5"]


def test_a_full_disk_leaves_every_file_as_it_was(tmp_path):
    table, surface = tmp_path / "track.csv", tmp_path / "patch.ply"
    write_together({table: b"old", surface: b"old"}, "the track")
    limit, most = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, most))  # a file of this size is where the disk is full
    try:
        with pytest.raises(FileProblem, match="cannot write the track"):
            write_together({table: b"new", surface: bytes(40_000)}, "the track")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, most))
    assert (table.read_bytes(), surface.read_bytes()) == (b"old", b"old")
    assert {path.name for path in tmp_path.iterdir()} == {"track.csv", "patch.ply"}
