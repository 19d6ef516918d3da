from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
import pytest

from pipeline.core import disk_store
from pipeline.core.arrays import freeze

CODE = ("pipeline.core.disk_store",)


@dataclass(frozen=True, slots=True, kw_only=True)
class Value:
    heights_mm: np.ndarray
    blocks: np.ndarray
    step_mm: float
    count: int
    notes: tuple[str, ...]


VALUE = Value(
    heights_mm=freeze(np.linspace(0.0, 1.0, 7)),
    blocks=freeze(np.arange(6, dtype=np.int16).reshape(2, 3)),
    step_mm=0.1,
    count=3,
    notes=("open at the back", "ä"),
)


def asked(folder, made_of="a mesh", value=VALUE, code=CODE, **more):
    """(the value, whether it was made this time)."""
    made = []
    found = disk_store.load_or_make(
        Value, made_of, code, lambda: made.append(1) or value, folder, **more
    )
    return found, bool(made)


def same(a, b):
    return all(
        np.array_equal(getattr(a, f.name), getattr(b, f.name))
        and np.asarray(getattr(a, f.name)).dtype == np.asarray(getattr(b, f.name)).dtype
        for f in fields(Value)
    )


def test_a_value_comes_back_the_same_with_arrays_that_nobody_can_write_to(tmp_path):
    assert asked(tmp_path) == (VALUE, True)
    found, made = asked(tmp_path)
    assert same(found, VALUE)
    assert not made
    assert not found.blocks.flags.writeable
    assert (type(found.step_mm), type(found.count), found.notes) == (float, int, VALUE.notes)
    assert [p.suffix for p in tmp_path.iterdir()] == [".npz"]


def test_other_content_and_other_code_are_other_values(tmp_path):
    asked(tmp_path)
    assert asked(tmp_path, made_of="another mesh")[1]
    assert asked(tmp_path, code=("pipeline.core.digests",))[1]


def test_a_package_stands_for_all_of_its_modules(tmp_path, monkeypatch):
    (tmp_path / "room").mkdir()
    for name in ("__init__", "a", "b"):
        (tmp_path / "room" / f"{name}.py").write_text("number = 1\n", "utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    asked(tmp_path / "kept", code=("room",))
    (tmp_path / "room" / "b.py").write_text("number = 2\n", "utf-8")
    assert asked(tmp_path / "kept", code=("room",))[1]


@pytest.mark.parametrize("damage", ["flipped", "cut", "empty", "another's"])
def test_a_damaged_file_is_made_again_wherever_the_damage_is(tmp_path, damage):
    asked(tmp_path)
    path = next(tmp_path.iterdir())
    whole = path.read_bytes()
    for at in range(0, len(whole), 9 if damage in ("flipped", "cut") else len(whole)):
        path.write_bytes(
            {
                "flipped": whole[:at] + bytes([whole[at] ^ 255]) + whole[at + 1 :],
                "cut": whole[:at],
                "empty": b"",
                "another's": whole.replace(
                    path.stem.encode("utf-32-le"), ("f" * 32).encode("utf-32-le")
                ),
            }[damage]
        )
        found, made = asked(tmp_path)
        assert same(found, VALUE), f"byte {at}"
        if made:
            assert path.read_bytes() == whole, f"byte {at}"
        path.write_bytes(whole)


def test_a_folder_that_cannot_be_written_is_no_error(tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("in the way")
    assert asked(blocked / "values") == (VALUE, True)


def test_the_oldest_files_go_when_there_are_too_many(tmp_path):
    for k in range(6):
        asked(tmp_path, made_of=k, most_files=3)
    assert len(list(tmp_path.iterdir())) == 3
    assert not asked(tmp_path, made_of=5)[1]
