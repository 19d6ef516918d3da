"""Recordings without a file: a live stream is opened by a name, as a file is."""

from collections.abc import Callable
from pathlib import Path

from pipeline.core.values.frames import Recording

_mounted: dict[str, Callable[[], Recording]] = {}


def mount(path: Path, make: Callable[[], Recording]) -> None:
    """Let `open_recording(path)` return `make()`."""
    _mounted[str(path)] = make


def unmount(path: Path) -> None:
    """Forget the recording at `path`, if any."""
    _mounted.pop(str(path), None)


def is_mounted(path: Path) -> bool:
    """Whether a recording is mounted at `path`."""
    return str(path) in _mounted


def open_mounted(path: Path) -> Recording | None:
    """The recording mounted at `path`; None where there is none."""
    make = _mounted.get(str(path))
    return None if make is None else make()
