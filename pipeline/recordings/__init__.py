"""Recordings of tactile sensors: every format of the field through one door."""

from pipeline.recordings.format_dispatch import open_recording

__all__ = ["open_recording"]
