from __future__ import annotations

import json
import math

import numpy as np
import pytest

from pipeline.base.errors import FileProblem
from pipeline.base.files import write_arrays, write_folder, write_json


def test_a_folder_appears_whole(tmp_path):
    write_folder(tmp_path / "frame", lambda part: (part / "a").write_text("new"))
    assert (tmp_path / "frame" / "a").read_text() == "new"


def test_a_folder_that_fails_half_way_leaves_the_old_one_and_nothing_else(tmp_path):
    write_folder(tmp_path / "frame", lambda part: (part / "a").write_text("old"))

    def interrupted(part):
        (part / "a").write_text("half")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_folder(tmp_path / "frame", interrupted)
    assert [p.name for p in tmp_path.iterdir()] == ["frame"]
    assert (tmp_path / "frame" / "a").read_text() == "old"


def test_json_says_null_for_what_is_not_a_number(tmp_path):
    write_json(tmp_path / "r.json", {"a": math.nan, "b": (1, np.float32(0.5)), "c": math.inf})
    assert json.loads((tmp_path / "r.json").read_text()) == {"a": None, "b": [1, 0.5], "c": None}


def test_arrays_come_back_without_pickle(tmp_path):
    arrays = {"depth.indentation_mm": np.arange(6, dtype=np.float32).reshape(2, 3), "n": np.asarray(3)}
    write_arrays(tmp_path / "a.npz", arrays)
    with np.load(tmp_path / "a.npz", allow_pickle=False) as back:
        assert set(back) == set(arrays)
        np.testing.assert_array_equal(back["depth.indentation_mm"], arrays["depth.indentation_mm"])


def test_a_place_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(FileProblem, match="cannot write the report"):
        write_json(tmp_path / "file" / "r.json", {})
