"""`tactoscope inspect`: what a recording is."""

from __future__ import annotations

from pathlib import Path

from pipeline.cli.terminal import print_line
from pipeline.inspection.recording import inspect, lines


def show(recording: Path, sensor: str, reference: Path | None) -> int:
    """Print the report; returns 0 if every check passed or could not be made, 1 if one failed."""
    report = inspect(recording, sensor=sensor, reference=reference)
    for line in lines(report):
        print_line(line)
    return 0 if report.passed else 1
