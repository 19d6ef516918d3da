"""`tactoscope export`, `make-case` and `case`."""

from __future__ import annotations

import os
import shlex
from pathlib import Path

from rich.console import Console
from rich.table import Table

from pipeline.cli.interrupts import interruptible_progress
from pipeline.cli.terminal import print_line
from pipeline.reporting.export import export_file
from pipeline.reporting.export_request import ExportRequest
from pipeline.reporting.repro_bundle import REPLAY_TOLERANCE, StageAgreement, replay_bundle, write_bundle
from pipeline.translation.translate import Request


def run_export(asked: ExportRequest) -> int:
    """Write one file; returns 0."""
    with interruptible_progress() as work:
        replaced = export_file(asked, work)
    for told in replaced:
        print_line(f"another method answered: {told}")
    print_line(f"{asked.pane} written to {os.fspath(asked.path)}")
    return 0


def run_bundle(request: Request, settings: tuple[str, ...], frame: int, folder: Path, note: str) -> int:
    """Write one case; returns 0."""
    with interruptible_progress() as work:
        write_bundle(request, settings, frame, folder, note=note, progress=work)
    print_line(f"case of frame {frame} written; play it again with: tactoscope case {shlex.quote(os.fspath(folder))}")
    return 0


def run_replay(folder: Path) -> int:
    """Play a case again and print how each slot agrees; returns 0 if all do, 1 otherwise."""
    with interruptible_progress() as work:
        played = replay_bundle(folder, work)
    if played.note:
        print_line(played.note)
    table = Table("slot", "arrays", "agrees", "differs most")
    for one in played.agreements:
        table.add_row(one.stage, str(one.n_arrays), _words(one), one.worst_array if one.largest_difference > 0 else "")
    Console().print(table)
    for name, value in played.metrics.items():
        print_line(f"{name} {value:.4g}, then {played.expected_metrics.get(name, float('nan')):.4g}")
    print_line("the same as when the case was made" if played.is_same else "not the same as when the case was made")
    return 0 if played.is_same else 1


def _words(one: StageAgreement) -> str:
    if one.largest_difference == 0:
        return "the same bytes"
    if one.largest_difference == float("inf"):
        return "another shape, or other gaps"
    how = "but for rounding" if one.largest_difference <= REPLAY_TOLERANCE else "NO"
    return f"{how}: {one.largest_difference:.2g} of its range"
