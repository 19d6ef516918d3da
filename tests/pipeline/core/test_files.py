from __future__ import annotations

import ast
import fcntl
import json
import math
import os
import pickle
import subprocess
import sys
import zipfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.core import files
from pipeline.core.errors import FileProblem, escape_text
from pipeline.core.files import (
    check_folder_for,
    open_atomic,
    read_bytes,
    read_cached_arrays,
    read_json,
    read_toml,
    require_file,
    require_separate,
    set_aside,
    write_arrays,
    write_folder,
    write_json,
    write_together,
)

_KILLED = """
import os, signal, sys
from pathlib import Path
from pipeline.core.files import write_folder
write_folder(Path(sys.argv[1]), lambda _: os.kill(os.getpid(), signal.SIGKILL))
"""
PACKAGES = ("pipeline", "app", "widgets")
ROOT = Path(__file__).parents[3]


def test_a_folder_appears_whole(tmp_path):
    write_folder(tmp_path / "frame", lambda part: (part / "a").write_text("new"))
    assert (tmp_path / "frame" / "a").read_text() == "new"


def test_a_folder_that_fails_half_way_leaves_the_old_one_and_nothing_else(tmp_path):
    write_folder(tmp_path / "frame", lambda part: (part / "a").write_text("old"), ("a",))

    def interrupted(part):
        (part / "a").write_text("half")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_folder(tmp_path / "frame", interrupted, ("a",))
    assert [p.name for p in tmp_path.iterdir()] == ["frame"]
    assert (tmp_path / "frame" / "a").read_text() == "old"


def test_what_cannot_be_written_into_a_folder_is_told_by_its_place_to_be(tmp_path):
    def fill(part):
        (part / "arrays.npz").mkdir()
        write_arrays(part / "arrays.npz", {})

    with pytest.raises(
        FileProblem, match=r"cannot write the arrays \(.*\): '.*/frame/arrays.npz'"
    ) as raised:
        write_folder(tmp_path / "frame", fill)
    assert raised.value.path == tmp_path / "frame" / "arrays.npz"


def test_two_that_write_one_folder_at_once_both_end_and_leave_a_whole_one(tmp_path):
    frame = tmp_path / "it's [a] frame"

    def slower(part):
        (part / "a").write_text("slower")
        write_folder(frame, lambda own: (own / "a").write_text("quicker"), ("a", "b"))
        (part / "b").write_text("slower")

    write_folder(frame, slower, ("a", "b"))
    assert {p.name: p.read_text() for p in frame.iterdir()} == {"a": "slower", "b": "slower"}
    assert [p.name for p in tmp_path.iterdir()] == [frame.name]


def test_what_a_killed_process_left_of_a_folder_goes_when_it_is_written_again(tmp_path):
    killed = subprocess.run([sys.executable, "-c", _KILLED, tmp_path / "frame"], check=False)
    assert killed.returncode == -9
    assert len(list(tmp_path.iterdir())) == 1
    write_folder(tmp_path / "frame", lambda part: (part / "a").write_text("new"))
    assert [p.name for p in tmp_path.iterdir()] == ["frame"]


_WRITING = """
import sys
from pathlib import Path
from pipeline.core.files import open_atomic
with open_atomic(Path(sys.argv[1]), "it", None) as file:
    file.write(b"slow")
    print("begun", flush=True)
    sys.stdin.read()
"""


def test_a_file_that_another_process_writes_is_no_leftover(tmp_path, monkeypatch):
    """Whatever its number: in containers every process has the same one."""
    command = [sys.executable, "-c", _WRITING, tmp_path / "a"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as other:
        assert other.stdout.readline() == b"begun\n"
        monkeypatch.setattr(os, "kill", lambda *_: (_ for _ in ()).throw(ProcessLookupError))
        monkeypatch.setattr(os, "getpid", lambda: other.pid)
        write_json(tmp_path / "b", {})
        write_json(tmp_path / "a", {})
    assert other.returncode == 0
    assert (tmp_path / "a").read_bytes() == b"slow"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "b"]


def test_many_writers_of_one_folder_do_not_take_each_other_for_leftovers(tmp_path):
    with ThreadPoolExecutor(4) as writers:
        list(
            writers.map(lambda number: write_json(tmp_path / f"{number}.json", number), range(300))
        )
    assert sorted(json.loads(path.read_text()) for path in tmp_path.iterdir()) == list(range(300))


def test_a_temporary_folder_made_anew_under_a_leftovers_name_is_kept(tmp_path, monkeypatch):
    leftover = tmp_path / f".tactoscope-{files._get_boot()}-1.part"
    leftover.mkdir()
    flock = fcntl.flock

    def replace_leftover(descriptor, operation):
        if operation & fcntl.LOCK_NB:  # another writer removed it, and its owner made it again
            leftover.rmdir()
            leftover.mkdir()
        flock(descriptor, operation)

    monkeypatch.setattr(files.fcntl, "flock", replace_leftover)
    write_json(tmp_path / "report.json", 1)
    assert leftover.is_dir()


def test_a_write_protected_file_is_not_replaced(tmp_path, monkeypatch):
    path = tmp_path / "a.csv"
    path.write_bytes(b"kept")
    path.chmod(0o444)
    # a superuser may write all
    monkeypatch.setattr(os, "access", lambda of, _: bool(Path(of).stat().st_mode & 0o222))
    with pytest.raises(FileProblem, match="write-protected"), open_atomic(path, "it", None):
        pass
    with pytest.raises(FileProblem, match="write-protected"):
        check_folder_for(path)
    assert path.read_bytes() == b"kept"
    assert [one.name for one in tmp_path.iterdir()] == ["a.csv"]


def test_a_replaced_file_keeps_its_permissions_and_a_link_stays_one(tmp_path):
    path = tmp_path / "a"
    link = tmp_path / "link"
    path.write_text("old")
    path.chmod(0o600)
    link.symlink_to("a")
    write_json(link, {"new": 1})
    assert link.is_symlink()
    assert json.loads(path.read_text()) == {"new": 1}
    assert path.stat().st_mode & 0o777 == 0o600


def test_a_folder_is_replaced_only_where_all_of_it_is_known(tmp_path):
    folder = tmp_path / "frame"
    folder.mkdir()
    write_folder(folder, lambda part: (part / "a").write_text("1"), ("a", "b"))
    write_folder(folder, lambda part: (part / "b").write_text("2"), ("a", "b"))
    for own in (("a", "b"), ("b",)):  # the first of them is missing, or another file is there
        (folder / "c").write_text("mine") if own == ("b",) else None
        with pytest.raises(FileProblem, match="holds other files"):
            write_folder(folder, lambda part: (part / "a").write_text("3"), own)
    assert (folder / "b").read_text() == "2"


def test_what_is_read_is_not_written_over(tmp_path):
    (tmp_path / "folder").mkdir()
    for name in ("a.npz", "folder/frame.png"):
        (tmp_path / name).write_text("mine")
    (tmp_path / "link").symlink_to("a.npz")
    for out, path in (
        ("a.npz", "link"),
        ("folder", "folder"),
        ("folder/frame.png", "folder"),
        ("a.npz", "./a.npz"),
    ):
        with pytest.raises(FileProblem, match="would replace what is read"):
            require_separate(tmp_path / out, [tmp_path / path])
    for out, path in (
        ("b.npz", "a.npz"),
        ("folder/new.png", "folder"),
        ("folder", "folder/frame.png"),
        ("a.npz", "no"),
    ):
        require_separate(tmp_path / out, [tmp_path / path])


def test_json_says_null_for_what_is_not_a_number(tmp_path):
    write_json(tmp_path / "r.json", {"a": math.nan, "b": (1, np.float32(0.5)), "c": math.inf})
    assert json.loads((tmp_path / "r.json").read_text()) == {"a": None, "b": [1, 0.5], "c": None}


def test_arrays_come_back_without_pickle(tmp_path):
    arrays = {
        "depth.indentation_mm": np.arange(6, dtype=np.float32).reshape(2, 3),
        "n": np.asarray(3),
    }
    write_arrays(tmp_path / "a.npz", arrays)
    with np.load(tmp_path / "a.npz", allow_pickle=False) as back:
        assert set(back) == set(arrays)
        np.testing.assert_array_equal(back["depth.indentation_mm"], arrays["depth.indentation_mm"])


def test_arrays_are_compressed_where_it_is_worth_the_time(tmp_path):
    rng = np.random.default_rng(0)
    arrays = {
        "mask": np.zeros((100, 100), bool),
        "index": np.arange(10_000, dtype=np.int32),
        "measured": rng.normal(size=10_000).astype(np.float32),
        "number": np.asarray(0.0),
        "none": np.zeros((0, 3)),
    }
    write_arrays(tmp_path / "a.npz", arrays)
    with zipfile.ZipFile(tmp_path / "a.npz") as file:
        kinds = {entry.filename: entry.compress_type for entry in file.infolist()}
    packed = [name for name, kind in kinds.items() if kind == zipfile.ZIP_DEFLATED]
    assert packed == ["mask.npy"]
    assert set(kinds) == {f"{name}.npy" for name in arrays}


def test_a_place_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(FileProblem, match="cannot write the report"):
        write_json(tmp_path / "file" / "r.json", {})


def test_a_file_that_fails_half_way_leaves_the_old_one_and_nothing_else(tmp_path):
    path = tmp_path / "a"
    path.write_bytes(b"old")

    def fails(error):
        with open_atomic(path, "the thing", None) as file:
            file.write(b"half")
            raise error

    with pytest.raises(FileProblem, match=r"cannot write the thing \(No space left on device\)"):
        fails(OSError(28, "No space left on device"))
    with pytest.raises(KeyboardInterrupt):
        fails(KeyboardInterrupt())
    assert [p.read_bytes() for p in tmp_path.iterdir()] == [b"old"]


def test_a_device_or_a_folder_is_not_replaced_by_a_file(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    for name in ("pipe", "folder"):
        with pytest.raises(FileProblem, match="a folder or a device of this name is there"):
            write_json(tmp_path / name, {})
    assert (tmp_path / "pipe").is_fifo()


@pytest.mark.parametrize(
    "read",
    [lambda p: read_bytes(p, "it"), lambda p: read_toml(p, "it"), lambda p: read_json(p, "it")],
)
def test_pipes_devices_folders_and_loops_are_refused_at_once(tmp_path, read):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "loop").symlink_to("loop")
    for path in (
        tmp_path / "pipe",
        Path("/dev/zero"),
        tmp_path,
        tmp_path / "loop",
        tmp_path / ("x" * 300),
    ):
        with pytest.raises(FileProblem, match="cannot read it"):
            read(path)


@pytest.mark.parametrize(
    "text", ["a = " + "[" * 20_000, "a = " + "1" * 5_000, "a = \xff", "a = [", "a = 1\na = 2"]
)
def test_toml_and_json_that_no_one_can_read_are_refused(tmp_path, text):
    path = tmp_path / "a"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(FileProblem, match="not valid TOML"):
        read_toml(path, "it")
    path.write_bytes(text.removeprefix("a = ").encode("latin-1"))
    with pytest.raises(FileProblem, match="not valid JSON"):
        read_json(path, "it")


def test_a_toml_file_of_another_use_is_named_with_it(tmp_path):
    path = tmp_path / "mine.toml"
    for text, what, words in (
        (
            'task = "residual"',
            "the alignment",
            "cannot read the alignment: this file is the recipe of a training",
        ),
        ('mesh = "key.stl"\ndepth_mm = 8', "the alignment", "a tool for insertion"),
        ('extends = "digit"', "the recipe", "the description of a sensor, to be given as --sensor"),
    ):
        path.write_text(text)
        with pytest.raises(FileProblem, match=words):
            read_toml(path, what)


def test_a_git_lfs_pointer_is_named_with_the_remedy(tmp_path):
    path = tmp_path / "weights.pth"
    path.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n")
    with pytest.raises(FileProblem, match="git lfs pull"):
        require_file(path, "the weights")


@given(st.text())
def test_text_from_outside_is_one_line_that_moves_no_cursor(text):
    shown = str(FileProblem(text, "a.h5"))
    assert not any(
        c in shown for c in map(chr, [*range(32), 127, *range(128, 160), 0x202E, 0x2028])
    )
    assert len(shown.splitlines()) == 1
    shown.encode("utf-8")
    assert escape_text(escape_text(text)) == escape_text(text)


def test_an_error_travels_between_processes_whole():
    error = pickle.loads(pickle.dumps(FileProblem("it is damaged", "a.h5")))
    assert (str(error), error.path) == ("it is damaged: 'a.h5'", Path("a.h5"))


def test_there_is_one_way_to_put_a_file_in_its_place():
    """Renaming over a file and opening one to write are for `base/files.py` alone, but for the
    log of the unforeseen.
    """
    found = [
        f"{file.relative_to(ROOT)}:{node.lineno}"
        for package in PACKAGES
        for file in (ROOT / package).rglob("*.py")
        for node in ast.walk(ast.parse(file.read_text()))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and _writes(node)
    ]
    assert [
        place
        for place in found
        if not place.startswith(("pipeline/core/files.py", "pipeline/core/user_folders.py"))
    ] == []


def _writes(call: ast.Call) -> bool:
    modes = [a.value for a in call.args if isinstance(a, ast.Constant) and isinstance(a.value, str)]
    name = call.func.attr
    on_text = isinstance(call.func.value, ast.Constant)
    if name in ("write_text", "write_bytes", "fsync", "rename"):
        return not (isinstance(call.func.value, ast.Name) and call.func.value.id == "files")
    renames = name == "replace" and len(call.args) == 1 and not call.keywords and not on_text
    return renames or (
        name == "open" and any(set(mode) & set("wax+") and len(mode) < 4 for mode in modes)
    )


def test_what_is_put_aside_is_not_lost_to_what_was_put_aside_before(tmp_path):
    path = tmp_path / "kept.json"
    for text in ("first", "second"):
        path.write_text(text)
        set_aside(path)
    assert {place.read_text() for place in tmp_path.iterdir()} == {"first", "second"}
    with pytest.raises(FileProblem, match="cannot put this file aside"):
        set_aside(path)


@pytest.mark.parametrize(
    "damage", ["missing", "empty", "zeroed", "noise", "cut", "one array", "a folder"]
)
def test_what_is_kept_and_damaged_in_any_way_is_as_good_as_not_there(tmp_path, damage):
    path = tmp_path / "kept.npz"
    np.savez_compressed(path, a=np.arange(999.0), b=np.ones(3))
    whole = path.read_bytes()
    assert np.array_equal(read_cached_arrays(path)["a"], np.arange(999.0))
    if damage == "a folder":
        path = tmp_path
    elif damage == "missing":
        path.unlink()
    elif damage == "one array":
        with path.open("wb") as file:
            np.save(file, np.arange(3))
    elif damage == "noise":  # any byte: names of methods that nobody knows, sizes beyond all memory
        rng = np.random.default_rng(1)
        for at in rng.permutation(len(whole))[:300]:
            path.write_bytes(whole[:at] + bytes([int(rng.integers(256))]) + whole[at + 1 :])
            found = read_cached_arrays(path)
            assert found is None or all(len(array) in (3, 999) for array in found.values())
        path.write_bytes(rng.bytes(len(whole)))
    else:
        path.write_bytes(
            {"empty": b"", "zeroed": bytes(len(whole)), "cut": whole[: len(whole) // 2]}[damage]
        )
    assert read_cached_arrays(path) is None


def test_what_cannot_be_read_back_replaces_nothing(tmp_path):
    path = tmp_path / "a.json"
    path.write_text("old")

    def refuse(written: Path) -> None:
        raise FileProblem("it holds nothing", written)

    with pytest.raises(
        FileProblem, match=r"cannot be read back as it was written \(it holds nothing\): '.*a.json'"
    ):
        write_json(path, {}, "the thing", refuse)
    assert path.read_text() == "old"
    with pytest.raises(FileProblem, match="cannot be read back"):
        write_together(tmp_path, {"a.json": b"new", "b": b"new"}, "the thing", refuse)
    assert [file.name for file in tmp_path.iterdir()] == ["a.json"]
    assert path.read_text() == "old"
