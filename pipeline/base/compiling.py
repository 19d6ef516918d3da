"""Which kernels there are, which of them are compiled, and how long compiling has held up a thread. Loads no numba.

A kernel is compiled when it is first called, and kept in a file beside its module; where nothing can be written there,
in the user's cache folder. Compiling holds the lock of a file, so that of several processes one compiles, and the
others wait and load.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Generator, Mapping
from functools import cache
from pathlib import Path

_ROOT = Path(__file__).parents[1]
_KERNEL = re.compile(r"^@(?:njit|kernel)\((?![^\n]*inline)[^\n]*\)\ndef (\w+)\(", re.MULTILINE)
_BELOW = re.compile(r"^from pipeline\.(\S+_kernels) import", re.MULTILINE)
_FORMAT = b"digest first"  # of the files: what is kept in another one is compiled again
_LONGEST_WAIT_S = 120.0  # for another process, which may have been stopped


class _Here(threading.local):
    """What compiling means to one thread."""

    depth = 0  # how often it asked for the compiler
    since_s = 0.0  # when it first did
    before = -1  # kernels compiled by then; -1 once it had to wait for another process
    spent_s = 0.0
    file = -1  # whose lock it holds
    tell: Callable[[str], None] | None = None


_here = _Here()
_compiled = 0  # kernels, by this process
_left: dict[str, Path] = {}  # what waited when this process first compiled, and was not compiled since


@contextlib.contextmanager
def report_compiling(tell: Callable[[str], None]) -> Generator[Callable[[], float]]:
    """Have `tell` called with "compiling, once: n of m" for all that this thread compiles meanwhile.

    Gives a function that says how many seconds that has held up this thread, waiting for others' compiling included.
    `tell` must not raise: it is called from the midst of the compiler.
    """
    before_s, outer = _here.spent_s, _here.tell
    _here.tell = tell
    try:
        yield lambda: _here.spent_s - before_s
    finally:
        _here.tell = outer


def spent_s() -> float:
    """Seconds that compiling has held up this thread so far."""
    return _here.spent_s


@cache
def list_kernels() -> Mapping[str, Path]:
    """By module and name, the file that keeps what is compiled of every kernel, be it there or not."""
    version = f"py{sys.version_info.major}{sys.version_info.minor}{getattr(sys, 'abiflags', '')}"
    found: dict[str, Path] = {}
    for path in sorted(_ROOT.rglob("*_kernels.py")):
        module = ".".join(path.relative_to(_ROOT.parent).with_suffix("").parts)
        source = path.read_text("utf-8")
        for match in _KERNEL.finditer(source):
            line = source.count("\n", 0, match.start()) + 1
            found[f"{module}.{match[1]}"] = kernel_folder(path) / f"{path.stem}.{match[1]}-{line}.{version}.nbi"
    return found


def list_uncompiled() -> dict[str, Path]:
    """Those of `kernels` whose file lacks what their source gives on this processor."""
    import llvmlite.binding

    processor = llvmlite.binding.get_host_cpu_name().encode()
    missing: dict[str, Path] = {}
    for name, file in list_kernels().items():
        kept = file.read_bytes() if file.is_file() else b""
        module = _ROOT.parent / (name.rpartition(".")[0].replace(".", "/") + ".py")
        if stamp(module) not in kept or processor not in kept:
            missing[name] = file
    return missing


@cache
def stamp(module: Path) -> bytes:
    """Digest of a module of kernels and of all those whose kernels it calls: a change there changes it too."""
    source = module.read_bytes()
    whole = hashlib.sha256(_FORMAT + source)
    for name in sorted(set(_BELOW.findall(source.decode()))):
        whole.update(stamp(_ROOT / (name.replace(".", "/") + ".py")))
    return whole.digest()


@cache
def kernel_folder(module: Path) -> Path:
    """Where what is compiled of a module is kept: in NUMBA_CACHE_DIR, else beside the module, else with this user.

    Where none of them can be written to, in a folder of this process alone, which ends with it.
    """
    import platformdirs

    inside, told = module.parent.relative_to(_ROOT), os.environ.get("NUMBA_CACHE_DIR")
    own = Path(platformdirs.user_cache_dir("tactoscope", appauthor=False), "kernels", *_ROOT.parts[1:])
    for place in (Path(told, "tactoscope", inside) if told else module.parent / "__pycache__", own / inside):
        with contextlib.suppress(OSError):
            place.mkdir(parents=True, exist_ok=True)
            if os.access(place, os.W_OK):
                return place
    return Path(_own_folder().name)


@cache
def _own_folder() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="tactoscope-kernels-")


def enter_compiler() -> None:
    """Note that this thread asks for the compiler."""
    _here.depth += 1
    if _here.depth == 1:
        _here.since_s, _here.before = time.perf_counter(), _compiled
        _lock()


def leave_compiler() -> None:
    """Note that this thread is done with the compiler, for now."""
    _here.depth -= 1
    if _here.depth == 0:
        if _here.file >= 0:
            os.close(_here.file)
            _here.file = -1
        if _compiled != _here.before:
            _here.spent_s += time.perf_counter() - _here.since_s


def begin_kernel(name: str) -> None:
    """Tell that this thread compiles a kernel, or some function that numba makes up for one."""
    global _compiled  # noqa: PLW0603 - changed under the compiler's lock
    if not _compiled:
        _left.update(list_uncompiled())
    _compiled += 1
    _left.pop(name, None)
    if _here.tell is not None:
        _here.tell(_said(len(list_kernels()) - len(_left), len(list_kernels())))


def _said(n: int, total: int) -> str:
    place, beside = kernel_folder(Path(__file__)), Path(__file__).parent
    if place.parent == Path(tempfile.gettempdir()):
        return f"compiling, as there is no folder to keep it in: {n} of {total}"
    kept = (
        "" if beside in place.parents or os.environ.get("NUMBA_CACHE_DIR") else f", kept in {os.fspath(place.parent)!r}"
    )
    return f"compiling, once{kept}: {n} of {total}"


def _lock() -> None:
    """Wait for other processes of the project to stop compiling. A folder without locks does without."""
    with contextlib.suppress(ImportError, OSError):
        import fcntl

        _here.file = os.open(
            kernel_folder(Path(__file__)) / "compiling.lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666
        )
        while time.perf_counter() < _here.since_s + _LONGEST_WAIT_S:
            with contextlib.suppress(BlockingIOError):
                fcntl.flock(_here.file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                return
            _here.before = -1
            time.sleep(0.05)
