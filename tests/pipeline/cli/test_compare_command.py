"""`tactoscope compare`: the other is this one with other options in place, unless it has a
recording of its own.
"""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from pipeline.cli.main import build_app, run_app

SAMPLE = Path(__file__).parents[3] / "sample_data" / "recordings" / "first_touch.h5"
_ONE = [str(SAMPLE), "--target", "gelslim", "--sensor", "digit", "--frame", "5", "--stage", "cloud"]


def test_the_other_is_this_one_with_its_options_in_place(tmp_path, capsys):
    words = ["compare", *_ONE, "--variant", "--set cloud.stride=4", "--out", str(tmp_path / "ways")]
    assert run_app(build_app(), words) == 0
    tiles = json.loads((tmp_path / "ways" / "compare.json").read_text())["tiles"]
    assert [tile["title"] for tile in tiles] == ["A · Cloud", "B · Cloud", "A minus B"]
    a, b = ((tmp_path / "ways" / tile["images"][0]).read_bytes() for tile in tiles[:2])
    assert a != b, "another stride"


@pytest.mark.parametrize(
    ("outside", "says"),
    [
        ("--nonsense 3", "--variant"),
        ("--set cloud.stride=many", "stride"),
        ("--set nowhere.stride=2", "nowhere"),
    ],
)
def test_what_is_wrong_with_the_other_is_one_sentence(tmp_path, capsys, outside, says):
    assert (
        run_app(
            build_app(), ["compare", *_ONE, "--variant", outside, "--out", str(tmp_path / "ways")]
        )
        == 2
    )
    assert says in capsys.readouterr().err
    assert not (tmp_path / "ways").exists()


@pytest.mark.parametrize(
    ("pairs", "says"),
    [
        (["--down", "cloud.stride=1,2"], "an axis is stage.parameter=value"),
        (["--across", "target_depth.method=surface,nonsense"], "nonsense"),
        (["--across", "cloud.stride=1,2", "--down", "cloud.stride=4"], "try the same"),
        (
            [
                "--across",
                "cloud.stride=1,2",
                "--down",
                "target_depth.jump_mm=1",
                "--metric",
                "touch_depth.nonsense",
            ],
            "touch_depth.nonsense",
        ),
        (["--across", "cloud.stride=0", "--down", "target_depth.jump_mm=1"], "stride"),
    ],
)
def test_what_is_wrong_with_a_grid_is_one_sentence(tmp_path, capsys, pairs, says):
    assert run_app(build_app(), ["compare", *_ONE, *pairs, "--out", str(tmp_path / "ways")]) == 2
    assert says in capsys.readouterr().err
    assert not (tmp_path / "ways").exists()


def test_a_grid_tries_methods_against_seeds_and_keeps_what_fails_in_its_cell(tmp_path, capsys):
    words = [
        "compare",
        *_ONE,
        "--across",
        "target_depth.method=surface,paper",
        "--down",
        "target_depth.jump_mm=1,2",
    ]
    assert run_app(build_app(), [*words, "--metric", "", "--out", str(tmp_path / "grid")]) == 0
    tiles = json.loads((tmp_path / "grid" / "compare.json").read_text())["tiles"]
    assert [tile["title"] for tile in tiles] == [
        f"target_depth.method={method}, target_depth.jump_mm={mm}"
        for mm in (1, 2)
        for method in ("surface", "paper")
    ]
    assert [bool(tile["images"]) for tile in tiles] == [True, False] * 2
    assert all("jump_mm" in tile["problem"] for tile in tiles[1::2])


@pytest.mark.parametrize(
    ("out", "says"), [(".", "holds other files ('mine.txt')"), ("mine.txt", "is a file")]
)
def test_what_is_in_the_way_stays_and_is_named_before_any_work(
    tmp_path, capsys, monkeypatch, out, says
):
    monkeypatch.setattr(
        "pipeline.cli.compare.compare_pair", lambda *_: pytest.fail("work was done first")
    )
    (tmp_path / "mine.txt").write_text("mine")
    words = ["compare", *_ONE, "--variant", "--set cloud.stride=4", "--out", str(tmp_path / out)]
    assert run_app(build_app(), words) == 2
    assert says in capsys.readouterr().err
    assert (tmp_path / "mine.txt").read_text() == "mine"
