"""Keep C libraries quiet: libpng, OpenCV's AVI reader and ffmpeg write a damaged file's own
bytes to the terminal.
"""

import contextlib
import os
import sys
import threading
from collections.abc import Generator

_lock = threading.Lock()
_n_inside = 0  # threads within the context
_saved = -1  # descriptor of the real stderr meanwhile


@contextlib.contextmanager
def silence_native_libraries() -> Generator[None, None, None]:
    """Discard what is written to the process's stderr.

    The caller raises an error of its own instead.
    """
    global _n_inside, _saved  # noqa: PLW0603 - a process has one stderr
    with _lock:
        if _n_inside == 0:
            # a window without a terminal has none
            with contextlib.suppress(OSError, ValueError, AttributeError):
                sys.stderr.flush()
            _saved = _redirect()
        _n_inside += 1
    try:
        yield
    finally:
        with _lock:
            _n_inside -= 1
            if _n_inside == 0 and _saved >= 0:
                os.dup2(_saved, 2)
                os.close(_saved)


def _redirect() -> int:
    """Point stderr to nowhere; returns a copy of the real one, -1 without one."""
    try:
        saved = os.dup(2)
        nowhere = os.open(os.devnull, os.O_WRONLY)
    except OSError:
        return -1
    os.dup2(nowhere, 2)
    os.close(nowhere)
    return saved
