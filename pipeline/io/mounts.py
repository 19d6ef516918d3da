"""Recordings without a file: a live stream is opened by a name, as a file is."""

import threading
from collections.abc import Callable
from pathlib import Path

from pipeline.core.values.frames import Recording

_lock = threading.Lock()
_mounted: dict[str, Callable[[], Recording]] = {}


def mount(path: Path, make: Callable[[], Recording]) -> None:
    """Let `open_recording(path)` return `make()`."""
    with _lock:
        _mounted[str(path)] = make


def unmount(path: Path) -> None:
    """Forget the recording at `path`, if any."""
    with _lock:
        _mounted.pop(str(path), None)


def is_mounted(path: Path) -> bool:
    """Whether a recording is mounted at `path`."""
    with _lock:
        return str(path) in _mounted


def open_mounted(path: Path) -> Recording | None:
    """The recording mounted at `path`; None where there is none."""
    with _lock:
        make = _mounted.get(str(path))
    return None if make is None else make()
