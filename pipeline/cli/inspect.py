"""`tactoscope inspect`: what a recording is."""

from __future__ import annotations

from pathlib import Path

from pipeline.cli.terminal import print_line
from pipeline.inspection.recording import inspect, lines
from pipeline.recordings.depth_arrays import DepthUnit


def show(recording: Path, sensor: str, reference: Path | None, depth_unit: DepthUnit = "auto") -> int:
    """Print the report; returns 0 if every check passed or could not be made, 1 if one failed."""
    report = inspect(recording, sensor=sensor, reference=reference, depth_unit=depth_unit)
    for line in lines(report):
        print_line(line)
    return 0 if report.passed else 1
