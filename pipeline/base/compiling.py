"""Where compiled kernels are cached, and how long compiling has held up a thread. Does not import numba.

Numba alone would load a cached kernel that calls a kernel of another module as it was before that module changed.
The cache folder is therefore named by a digest of all kernel sources and of the versions that compile them.
"""

import contextlib
import hashlib
import importlib.metadata
import os
import shutil
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Generator
from functools import cache
from pathlib import Path

from pipeline.base.user_folders import find_user_folder

_PACKAGE_FOLDER = Path(__file__).parents[1]
_MAX_FOLDERS = 16  # caches of other sources that are kept, the last used; 3 MB each


class _ThreadState(threading.local):
    """What compiling means to one thread."""

    spent_s = 0.0
    report: Callable[[str], None] | None = None


Compiler = Callable[[str, str, object], bool]  # (module, kernel, types of its arguments) -> whether it is cached now

_thread = _ThreadState()
_n_compiled = 0
_compiler: Compiler | None = None


@contextlib.contextmanager
def report_compiling(report: Callable[[str], None]) -> Generator[Callable[[], float]]:
    """Call `report` with a sentence for each kernel that this thread compiles in the block.

    Yields a function that returns the seconds that compiling has taken in the block so far. `report` must not raise:
    it is called from inside the compiler.
    """
    before_s, outer = _thread.spent_s, _thread.report
    _thread.report = report
    try:
        yield lambda: _thread.spent_s - before_s
    finally:
        _thread.report = outer


def spent_s() -> float:
    """Return the seconds that compiling has held up this thread so far."""
    return _thread.spent_s


def count_compiled() -> int:
    """Return the number of kernels that this process has compiled."""
    return _n_compiled


def set_compiler(compiler: Compiler | None) -> None:
    """Let `compiler` compile kernels that the cache lacks; None compiles them in this process."""
    global _compiler  # noqa: PLW0603 - set once, at the start
    _compiler = compiler


def compile_elsewhere(module: str, name: str, signature: object) -> bool:
    """Return whether another process compiled a kernel of a module into the cache; reported like any other."""
    if _compiler is None or not hasattr(sys.modules.get(module), name):
        return False
    begin_kernel()
    started_s = time.perf_counter()
    try:
        return _compiler(module, name, signature)
    finally:
        end_kernel(time.perf_counter() - started_s)


def begin_kernel() -> None:
    """Record and report that this thread compiles a kernel."""
    global _n_compiled  # noqa: PLW0603 - changed under the compiler's lock
    _n_compiled += 1
    if _thread.report is not None:
        _thread.report(f"compiling kernels, once: {_n_compiled}")


def end_kernel(seconds: float) -> None:
    """Add the time (s) that a kernel took to compile to this thread's account."""
    _thread.spent_s += seconds


@cache
def kernel_folder() -> Path:
    """Return the folder of compiled kernels: in NUMBA_CACHE_DIR if set, else in the user's cache.

    Where neither can be written, a temporary folder of this process is used.
    """
    given = os.environ.get("NUMBA_CACHE_DIR")
    root = Path(given) if given else find_user_folder("cache")
    folder = root / "kernels" / digest_sources()
    with contextlib.suppress(OSError):
        is_new = not folder.is_dir()
        folder.mkdir(parents=True, exist_ok=True)
        if os.access(folder, os.W_OK):
            os.utime(folder)  # last use
            if is_new:
                _remove_old_folders(folder)
            return folder
    return Path(_temporary_folder().name)


@cache
def digest_sources() -> str:
    """Return a digest of all kernel sources and of the versions of Python and numba."""
    whole = hashlib.sha256(f"{sys.version} {importlib.metadata.version('numba')} {_PACKAGE_FOLDER}".encode())
    for path in sorted(_PACKAGE_FOLDER.rglob("*_kernels.py")):
        whole.update(path.read_bytes())
    return whole.hexdigest()[:16]


def _remove_old_folders(current: Path) -> None:
    others = sorted((p for p in current.parent.iterdir() if p != current), key=lambda p: p.stat().st_mtime)
    for old in others[:-_MAX_FOLDERS]:
        shutil.rmtree(old, ignore_errors=True)


@cache
def _temporary_folder() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="tactoscope-kernels-")
