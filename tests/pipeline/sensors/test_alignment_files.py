from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.core.errors import FileProblem, escape_text
from pipeline.core.geometry import rigid
from pipeline.sensors.alignment import (
    Alignment,
    AlignmentFile,
    format_alignment,
    load_alignment,
    resolve_alignment,
    save_alignment,
)
from pipeline.sensors.spec import load_sensor

# mm and entries of a rotation: twelve decimals of degrees and millimetres are kept
ROUNDING = 1e-11
GOOD = format_alignment(
    AlignmentFile(
        alignment=resolve_alignment(load_sensor("gelslim"), load_sensor("soft_bubble")),
        source="gelslim",
        target="soft_bubble",
        origin="the descriptions",
    )
)
numbers = st.tuples(*[st.floats(-150.0, 150.0)] * 3)


def written(folder, text):
    path = folder / "pair.toml"
    path.write_text(text, encoding="utf-8")
    return path


@given(numbers, numbers, numbers, numbers)
def test_a_saved_alignment_is_loaded_as_written(tmp_path_factory, a, b, c, d):
    path = tmp_path_factory.mktemp("kept") / "new folder" / "pair.toml"
    kept = Alignment(
        alignment_from_source=rigid.from_parts(a, b), target_from_alignment=rigid.from_parts(c, d)
    )
    save_alignment(
        path, AlignmentFile(alignment=kept, source="gelslim", target="digit", origin='by "eye"')
    )
    back = load_alignment(path, source="gelslim", target="digit")
    assert back.origin == 'by "eye"'
    np.testing.assert_allclose(
        back.alignment.alignment_from_source, kept.alignment_from_source, atol=ROUNDING
    )
    np.testing.assert_allclose(
        back.alignment.target_from_alignment, kept.target_from_alignment, atol=ROUNDING
    )
    assert [p.name for p in path.parent.iterdir()] == ["pair.toml"]


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("[target_from_alignment]", "[somewhere]", "target_from_alignment: it is missing"),
        ("translation_mm", "translation_m", "alignment_from_source.translation_mm: it is missing"),
        (
            "rotation_deg = [",
            "rotation_deg = [1.0, ",
            "alignment_from_source.rotation_deg: expected a list of length 3",
        ),
        (
            "rotation_deg = [0.0",
            "rotation_deg = [nan",
            "alignment_from_source.rotation_deg[0]: expected a number",
        ),
        (
            "rotation_deg = [0.0",
            "rotation_deg = [true",
            "alignment_from_source.rotation_deg[0]: expected a number, got true or false",
        ),
        (
            'source = "gelslim"',
            'source = "digit"',
            "has the source 'digit', not 'gelslim'; choose the file",
        ),
        ('source = "gelslim"', "source = 3", "source: expected a text, got a whole number"),
        ("translation_mm = [", "translation_mm = ", "not valid TOML"),
    ],
)
def test_an_invalid_file_is_refused_by_its_key(tmp_path, old, new, problem):
    assert old in GOOD
    path = written(tmp_path, GOOD.replace(old, new, 1))
    with pytest.raises(FileProblem) as caught:
        load_alignment(path, source="gelslim", target="soft_bubble")
    assert problem in str(caught.value)
    assert str(caught.value).endswith(f"'{path}'")


def test_a_file_of_the_reverse_direction_is_refused(tmp_path):
    with pytest.raises(FileProblem, match="swap source and target"):
        load_alignment(written(tmp_path, GOOD), source="soft_bubble", target="gelslim")


def test_a_file_that_is_missing_or_no_text_is_refused(tmp_path):
    with pytest.raises(FileProblem, match="cannot read the alignment"):
        load_alignment(tmp_path / "nothing.toml", source="gelslim", target="digit")
    binary = tmp_path / "binary.toml"
    binary.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(FileProblem, match="not valid TOML"):
        load_alignment(binary, source="gelslim", target="digit")


def test_a_path_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(FileProblem, match="cannot write the alignment"):
        save_alignment(
            tmp_path / "file" / "pair.toml",
            load_alignment(written(tmp_path, GOOD), source="gelslim", target="soft_bubble"),
        )


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("translation_mm", "1e6"),
        ("translation_mm", "1e300"),
        ("translation_mm", "nan"),
        ("translation_mm", "1" + "0" * 400),
        ("rotation_deg", "1e20"),
        ("rotation_deg", "true"),
    ],
)
def test_an_alignment_of_a_kilometre_or_of_many_turns_is_refused(tmp_path, key, value):
    lines = [
        f"{key} = [0.0, {value}, 0.0]" if line.startswith(key) else line
        for line in GOOD.splitlines()
    ]
    with pytest.raises(FileProblem, match=rf"{key}\[1\]: (expected|Number)"):
        load_alignment(written(tmp_path, "\n".join(lines)), source="gelslim", target="soft_bubble")


@pytest.mark.parametrize(
    "origin", ["a\x1b[31m", "b\x7f", "c\udcff.h5", "d\n[x]", 'e"\\', "\U0001f600"]
)
def test_any_origin_text_can_be_read_again(tmp_path, origin):
    kept = replace(
        load_alignment(written(tmp_path, GOOD), source="gelslim", target="soft_bubble"),
        origin=origin,
    )
    save_alignment(tmp_path / "again.toml", kept)
    again = load_alignment(tmp_path / "again.toml", source="gelslim", target="soft_bubble")
    assert again.origin == escape_text(origin)
