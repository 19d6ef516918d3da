"""Recordings of tactile sensors; `open_recording` reads every format of `formats.FORMATS`."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pipeline.io.format_dispatch import open_recording

__all__ = ["open_recording"]


def __getattr__(name: str) -> Any:
    """Import `open_recording` on first use, so that the table of formats alone loads in a few
    milliseconds.
    """
    if name == "open_recording":
        from pipeline.io.format_dispatch import open_recording

        return open_recording
    raise AttributeError(name)
