"""The cache of compiled kernels: named by its sources, tolerant of damage, reported while it is
filled.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from pipeline.core import compiling

KERNEL_CALL = """
import json
import numpy as np
from pipeline.core import compiling
from pipeline.core.geometry.membrane_kernels import lower_to_triangles
sentences = []
with compiling.report_compiling(sentences.append) as spent_s:
    for _ in range(2):
        lower_to_triangles(np.zeros((3, 3)), np.zeros((1, 3), np.int32), np.ones((2, 2)), np.zeros((2, 2), np.int32))
print(json.dumps([sentences, spent_s(), compiling.count_compiled(), str(compiling.kernel_folder())]))
"""


NO_COMPILING_HERE = """
from numba.core import dispatcher
from pipeline.core import kernel_compiler
kernel_compiler.compile_in_own_process()
dispatcher._FunctionCompiler.compile = None
"""
NO_PROCESS = """
from pipeline.core import kernel_compiler
kernel_compiler.compile_in_own_process()
kernel_compiler._SERVE = "raise SystemExit"
"""


PIPELINE = Path(compiling.__file__).parents[1]


def call_kernel(
    cache: Path, before: str = "", clone: Path = PIPELINE.parent
) -> tuple[list[str], float, int, Path]:
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(cache)}
    done = subprocess.run(
        [sys.executable, "-c", before + KERNEL_CALL],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
        timeout=100,
        cwd=clone,
    )
    sentences, spent_s, n, folder = json.loads(done.stdout)
    return sentences, spent_s, n, Path(folder)


def test_a_kernel_is_compiled_once_reported_and_loaded_by_the_next_process(tmp_path):
    sentences, spent_s, n, folder = call_kernel(tmp_path)
    assert n >= 1
    assert len(sentences) == n
    assert spent_s > 0
    assert folder.is_relative_to(tmp_path)
    assert call_kernel(tmp_path) == ([], 0.0, 0, folder)


def test_another_process_compiles_so_that_this_one_only_loads(tmp_path):
    sentences, spent_s, n, folder = call_kernel(tmp_path, NO_COMPILING_HERE)
    assert (len(sentences), n) == (1, 1)
    assert spent_s > 0
    assert call_kernel(tmp_path, NO_COMPILING_HERE) == ([], 0.0, 0, folder)


def test_a_kernel_is_compiled_here_where_no_process_can(tmp_path):
    assert call_kernel(tmp_path, NO_PROCESS)[2] >= 1
    assert call_kernel(tmp_path)[2] == 0


def test_damaged_cache_files_are_compiled_again(tmp_path):
    folder = call_kernel(tmp_path)[3]
    files = [
        path for path in folder.rglob("*") if path.is_file() and "lower_to_triangles" in path.name
    ]
    assert files
    for path in files:
        path.write_bytes(path.read_bytes()[:40])
    assert call_kernel(tmp_path)[2] >= 1
    assert call_kernel(tmp_path)[2] == 0


def test_a_cache_that_cannot_be_written_costs_a_compilation_only(tmp_path, monkeypatch):
    from numba.core.caching import IndexDataCacheFile

    from pipeline.core import cached_kernels

    def fail(*_arguments):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(IndexDataCacheFile, "save", fail)

    @cached_kernels.kernel()
    def add_one(x):
        return x + 1

    assert add_one(1) == 2


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A package with one module of kernels; its folder and digest are computed anew."""
    (tmp_path / "package").mkdir()
    source = tmp_path / "package" / "one_kernels.py"
    source.write_text("x = 1\n")
    monkeypatch.setattr(compiling, "_PACKAGE_FOLDER", tmp_path / "package")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))

    def find_folder() -> Path:
        compiling.kernel_folder.cache_clear()
        return compiling.kernel_folder()

    yield source, find_folder
    compiling.kernel_folder.cache_clear()


def test_a_changed_source_has_another_folder_and_those_unused_for_longest_are_removed(package):
    source, find_folder = package
    folders = []
    for value in range(20):
        source.write_text(f"x = {value}\n")
        folders.append(find_folder())
        os.utime(folders[-1], (value, value))
        source.write_text("x = 0\n")
        assert find_folder() == folders[0], "used again"
    assert len(set(folders)) == 20
    assert [folder.exists() for folder in folders] == [True] + [False] * 3 + [True] * 16


def test_a_folder_that_cannot_be_written_is_replaced_by_a_temporary_one(
    package, tmp_path, monkeypatch
):
    _, find_folder = package
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    folder = find_folder()
    assert folder.is_dir()
    assert not folder.is_relative_to(tmp_path)


def test_every_kernel_uses_the_tolerant_cache():
    from pipeline.core.cached_kernels import _TolerantCache
    from pipeline.core.geometry.membrane_kernels import lower_to_triangles

    lower_to_triangles(
        np.zeros((3, 3)), np.zeros((1, 3), np.int32), np.ones((2, 2)), np.zeros((2, 2), np.int32)
    )
    assert isinstance(lower_to_triangles._cache, _TolerantCache)


def test_the_compiler_takes_no_module_from_the_folder_it_runs_in(tmp_path, monkeypatch):
    from pipeline.core import kernel_compiler
    from pipeline.core.geometry.membrane_kernels import lower_to_triangles

    (tmp_path / "pipeline.py").write_text("open('seen', 'w').close()\n")
    monkeypatch.chdir(tmp_path)
    lower_to_triangles(
        np.zeros((3, 3)), np.zeros((1, 3), np.int32), np.ones((2, 2)), np.zeros((2, 2), np.int32)
    )
    process = kernel_compiler._CompilerProcess()
    try:
        assert process.compile(
            lower_to_triangles.__module__,
            "lower_to_triangles",
            lower_to_triangles.signatures[0],
        )
    finally:
        process.stop()
    assert not (tmp_path / "seen").exists()


def test_a_compiler_that_is_stopped_is_given_up(monkeypatch):
    from pipeline.core import kernel_compiler
    from pipeline.core.geometry.membrane_kernels import lower_to_triangles

    lower_to_triangles(
        np.zeros((3, 3)), np.zeros((1, 3), np.int32), np.ones((2, 2)), np.zeros((2, 2), np.int32)
    )
    monkeypatch.setattr(
        kernel_compiler, "_SERVE", "import os, signal; os.kill(os.getpid(), signal.SIGSTOP)"
    )
    process = kernel_compiler._CompilerProcess()
    assert not process.compile(
        lower_to_triangles.__module__,
        "lower_to_triangles",
        lower_to_triangles.signatures[0],
    )
    assert process._process is None


def test_two_clones_and_a_moved_one_share_their_kernels(tmp_path):
    """Only contents count: the same sources elsewhere load what was compiled once."""
    cache = tmp_path / "cache"
    for number, place in enumerate(("one", "two")):
        clone = tmp_path / place
        shutil.copytree(
            PIPELINE, clone / "pipeline", ignore=shutil.ignore_patterns("shipped", "__pycache__")
        )
        assert (call_kernel(cache, clone=clone)[2] == 0) == (number > 0)
    (tmp_path / "two").rename(tmp_path / "moved")
    assert call_kernel(cache, clone=tmp_path / "moved")[2] == 0


@pytest.mark.parametrize("of", ["group", "others", "link", "owner"])
def test_kernels_that_another_user_may_have_written_are_not_run(
    package, tmp_path, of, monkeypatch, caplog
):
    _, find_folder = package
    monkeypatch.setattr(compiling, "find_user_folder", lambda _: tmp_path / "own")
    folder = find_folder()
    assert folder.is_relative_to(tmp_path / "cache")
    assert folder.stat().st_mode & 0o077 == 0
    if of == "link":
        folder.rename(tmp_path / "elsewhere")
        folder.symlink_to(tmp_path / "elsewhere")
    elif of == "owner":
        real = os.geteuid()
        monkeypatch.setattr(os, "geteuid", lambda: real + 1)
    else:
        folder.chmod(0o770 if of == "group" else 0o707)
    assert not find_folder().is_relative_to(tmp_path / "cache")
    assert "that others own or may write" in caplog.text
