"""Recordings that are no files: what is watched now is opened by a name, as a file is."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path

from pipeline.values.frames import Recording

_lock = threading.Lock()
_held: dict[str, Callable[[], Recording]] = {}


def mount(path: Path, make: Callable[[], Recording]) -> None:
    """From now on `open_recording(path)` gives what `make` does."""
    with _lock:
        _held[str(path)] = make


def unmount(path: Path) -> None:
    """The name means nothing any more."""
    with _lock:
        _held.pop(str(path), None)


def is_mounted(path: Path) -> bool:
    """Whether something is held under a name."""
    with _lock:
        return str(path) in _held


def open_mounted(path: Path) -> Recording | None:
    """What is held under a name; None for a path like any other."""
    with _lock:
        make = _held.get(str(path))
    return None if make is None else make()
