"""Where compiled kernels are cached, and how long compiling has held up a thread. Does not import
numba.

Numba alone would load a cached kernel that calls a kernel of another module as it was before that
module changed. The cache folder is therefore named by a digest of all kernel sources and of the
versions that compile them, and of no path: all clones of the same sources share it. What it holds
is run, so that it must belong to this user alone.
"""

import contextlib
import hashlib
import importlib.metadata
import logging
import os
import shutil
import stat
import sys
import threading
import time
from collections.abc import Callable, Generator
from functools import cache
from pathlib import Path

from pipeline.core.user_folders import find_user_folder, make_temporary_folder

log = logging.getLogger("tactoscope")
_PACKAGE_FOLDER = Path(__file__).parents[1]
_MAX_FOLDERS = 16  # caches of other sources that are kept, the last used; 3 MB each


class _ThreadState(threading.local):
    """What compiling means to one thread."""

    spent_s = 0.0
    report: Callable[[str], None] | None = None


# (module, kernel, types of its arguments) -> whether it is cached now
Compiler = Callable[[str, str, object], bool]

_thread = _ThreadState()
_n_compiled = 0
_compiler: Compiler | None = None


@contextlib.contextmanager
def report_compiling(report: Callable[[str], None]) -> Generator[Callable[[], float]]:
    """Call `report` with a sentence for each kernel that this thread compiles in the block.

    Yields a function that returns the seconds that compiling has taken in the block so far.
    `report` must not raise: it is called from inside the compiler.
    """
    before_s = _thread.spent_s
    outer = _thread.report
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
    """Return whether another process compiled a kernel of a module into the cache.

    Reported like any other.
    """
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

    Where neither can be written, or others could write into it, a temporary folder of this process
    is used.
    """
    given = os.environ.get("NUMBA_CACHE_DIR")
    for root in (*([Path(given)] if given else []), find_user_folder("cache")):
        with contextlib.suppress(OSError, ValueError):
            folder = _prepare_folder(root / "kernels")
            if folder is not None:
                return folder
    temporary = make_temporary_folder() / "kernels"
    temporary.mkdir(exist_ok=True)
    return temporary


def _prepare_folder(kernels: Path) -> Path | None:
    """The folder of these sources within that of all kernels.

    None where it cannot be used. Raises OSError.
    """
    folder = kernels / digest_sources()
    is_new = not folder.is_dir()
    kernels.parent.mkdir(parents=True, exist_ok=True)
    for place in (kernels, folder):
        place.mkdir(mode=0o700, exist_ok=True)
        if not _is_private(place):
            log.warning(
                "compiled kernels are not taken from a folder that others own or may write: '%s'",
                place,
            )
            return None
    if not os.access(folder, os.W_OK):
        return None
    os.utime(folder)  # last use
    if is_new:
        _remove_old_folders(folder)
    return folder


def _is_private(folder: Path) -> bool:
    """Whether a folder, not a link to one, belongs to this user, and no other one may write into
    it.
    """
    found = folder.lstat()
    is_own = stat.S_ISDIR(found.st_mode) and found.st_uid == os.geteuid()
    # earlier versions left it as the user's mask says; it holds folders alone
    if is_own and folder.name == "kernels":
        folder.chmod(0o700)
        return True
    return is_own and not found.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def digest_sources() -> str:
    """Return a digest of the names and contents of all kernel sources, and of the versions that
    compile them.
    """
    versions = [importlib.metadata.version(name) for name in ("numba", "llvmlite", "numpy")]
    whole = hashlib.sha256(f"{sys.version} {versions}".encode())
    for path in sorted(_PACKAGE_FOLDER.rglob("*_kernels.py")):
        content = path.read_bytes()
        whole.update(f"{path.relative_to(_PACKAGE_FOLDER)} {len(content)} ".encode() + content)
    return whole.hexdigest()[:16]


def _remove_old_folders(current: Path) -> None:
    others = sorted(
        (p for p in current.parent.iterdir() if p != current), key=lambda p: p.stat().st_mtime
    )
    for old in others[:-_MAX_FOLDERS]:
        shutil.rmtree(old, ignore_errors=True)
