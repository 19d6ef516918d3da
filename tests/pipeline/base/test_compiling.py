"""What is said and kept of compiling, in new processes with a cache of their own."""

from __future__ import annotations

import gc
import importlib
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from pipeline.base import compiling

KERNEL = "pipeline.geometry.membrane_kernels.level_distance"
ASK = """
import json
import numpy as np
from pipeline.base import compiling
before = compiling.waiting()
said = []
with compiling.watched(said.append) as held_up_s:
    from pipeline.geometry.membrane_kernels import level_distance
    for _ in range(2):
        level_distance(np.zeros(6, np.float32), 1.0, np.empty(2))
from numba.core.errors import termcolor
assert termcolor().errmsg("no match") == "no match", "the compiler's errors, which nobody sees, are coloured"
print(json.dumps([sorted(before), said, held_up_s(), sorted(compiling.waiting()), len(compiling.kernels())]))
"""


def started(cache: Path) -> subprocess.Popen[str]:
    ours = {**os.environ, "NUMBA_CACHE_DIR": str(cache)}
    return subprocess.Popen([sys.executable, "-c", ASK], env=ours, stdout=subprocess.PIPE, text=True)


def told(process: subprocess.Popen[str]):
    out, _ = process.communicate(timeout=100)
    assert process.returncode == 0
    return json.loads(out)


def test_compiling_is_said_once_timed_and_kept_for_the_next_process(tmp_path):
    before, said, held_up_s, after, n = told(started(tmp_path))
    assert len(before) == n
    assert said == [f"compiling, once: 1 of {n}"]
    assert held_up_s > 0.0
    assert set(before) - set(after) == {KERNEL}
    again, said, held_up_s, *_ = told(started(tmp_path))
    assert again == after
    assert said == []
    assert held_up_s == 0.0


def test_of_several_processes_at_once_one_compiles_and_the_others_wait_for_it(tmp_path):
    processes = [started(tmp_path) for _ in range(2)]
    answers = [told(process) for process in processes]
    assert sum(len(said) for _, said, *_ in answers) == 1
    assert all(KERNEL not in after for _, _, _, after, _ in answers)


def test_every_kernel_that_is_kept_is_counted_and_none_that_goes_into_others():
    from numba.core.caching import NullCache
    from numba.core.registry import CPUDispatcher

    kept = set()
    for name in {name.rpartition(".")[0] for name in compiling.list_kernels()}:
        module = importlib.import_module(name)
        own = [d for d in vars(module).values() if isinstance(d, CPUDispatcher) and d.__module__ == name]
        kept |= {f"{name}.{d.__name__}" for d in own if not isinstance(d._cache, NullCache)}
    assert kept == set(compiling.list_kernels())
    assert "pipeline.stages.depth.change_detection_kernels.block_change" in kept


@pytest.fixture
def small_tree(tmp_path, monkeypatch):
    """Two modules of kernels, one calling the other's."""
    monkeypatch.setattr(compiling, "_ROOT", tmp_path / "pipeline")
    (tmp_path / "pipeline").mkdir()
    for kept in (compiling.stamp, compiling.kernel_folder, compiling.list_kernels):
        kept.cache_clear()
    upper, lower = (tmp_path / "pipeline" / f"{name}_kernels.py" for name in ("upper", "lower"))
    lower.write_text("@njit(cache=True)\ndef low(x):\n    return x\n")
    upper.write_text("from pipeline.lower_kernels import low\n\n\n@njit(inline='always')\ndef part(x):\n    return x\n")
    yield upper, lower
    for kept in (compiling.stamp, compiling.kernel_folder, compiling.list_kernels):
        kept.cache_clear()


def test_a_change_below_makes_what_rests_on_it_stale(small_tree):
    upper, lower = small_tree
    before = compiling.stamp(upper), compiling.stamp(lower)
    lower.write_text(lower.read_text().replace("return x", "return -x"))
    compiling.stamp.cache_clear()
    assert compiling.stamp(lower) != before[1]
    assert compiling.stamp(upper) != before[0]
    assert list(compiling.list_kernels()) == [
        "pipeline.lower_kernels.low"
    ]  # what is inlined is compiled with its callers


def test_where_the_program_cannot_write_the_user_keeps_what_is_compiled(small_tree, tmp_path, monkeypatch):
    upper, _ = small_tree
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "user"))
    monkeypatch.setattr(os, "access", lambda path, mode: tmp_path / "user" in Path(path).parents)
    assert tmp_path / "user" / "tactoscope" / "kernels" in compiling.kernel_folder(upper).parents
    assert not compiling.kernel_folder(upper).is_relative_to(tmp_path / "pipeline")
    compiling.kernel_folder.cache_clear()
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    assert compiling.kernel_folder(upper).is_dir()
    assert not compiling.kernel_folder(upper).is_relative_to(tmp_path)


def test_no_garbage_is_looked_for_while_the_compiler_runs():
    kept = importlib.import_module("pipeline.base.cached_kernels")
    seen: list[bool] = []

    class Asked(kept.event.Listener):
        def on_start(self, event):
            seen.append(gc.isenabled())

        def on_end(self, event):
            pass

    with kept.event.install_listener("numba:run_pass", Asked()):
        assert kept.njit(lambda x: x + 1)(1) == 2
    assert seen
    assert not any(seen)
    assert gc.isenabled()


@pytest.mark.parametrize("suffix", ["nbi", "nbc"])
def test_a_damaged_file_of_a_kernel_is_as_good_as_none_and_is_written_again(tmp_path, suffix):
    kept = importlib.import_module("pipeline.base.cached_kernels")._Whole(str(tmp_path), "kernel-1.py3", b"stamp")
    kept.save("a signature", ("machine code", b"\x90" * 64))
    (file,) = tmp_path.glob(f"*.{suffix}")
    whole = file.read_bytes()
    flipped = [whole[:k] + bytes([whole[k] ^ 1]) + whole[k + 1 :] for k in range(len(whole))]
    for damaged in (b"", whole[:10], whole[:-1], bytes(len(whole)), b"\xff" * len(whole), *flipped):
        file.write_bytes(damaged)
        assert kept.load("a signature") is None
    kept.save("a signature", ("machine code", b"\x90" * 64))
    assert kept.load("a signature") == ("machine code", b"\x90" * 64)


def test_a_kernel_whose_files_cannot_be_written_works_all_the_same(tmp_path):
    kept = importlib.import_module("pipeline.base.cached_kernels")._Whole(
        str(tmp_path / "gone"), "kernel-1.py3", b"stamp"
    )
    kept.save("a signature", "machine code")
    assert kept.load("a signature") is None
