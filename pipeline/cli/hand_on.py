"""`tactoscope export`, `make-case` and `case`."""

from __future__ import annotations

import os
import shlex
from pathlib import Path

from rich.console import Console
from rich.table import Table

from pipeline.cli.stopping import stoppable
from pipeline.cli.terminal import print_line
from pipeline.reporting.asked import Asked
from pipeline.reporting.cases import CLOSE, Agreement, make_case, replay
from pipeline.reporting.exports import export
from pipeline.translation.translate import Request


def write_export(asked: Asked) -> int:
    """Write one file; returns 0."""
    with stoppable() as work:
        replaced = export(asked, work)
    for told in replaced:
        print_line(f"another method answered: {told}")
    print_line(f"{asked.pane} written to {os.fspath(asked.path)}")
    return 0


def write_case(request: Request, settings: tuple[str, ...], frame: int, folder: Path, note: str) -> int:
    """Write one case; returns 0."""
    with stoppable() as work:
        make_case(request, settings, frame, folder, note=note, progress=work)
    print_line(f"case of frame {frame} written; play it again with: tactoscope case {shlex.quote(os.fspath(folder))}")
    return 0


def replay_case(folder: Path) -> int:
    """Play a case again and print how each slot agrees; returns 0 if all do, 1 otherwise."""
    with stoppable() as work:
        played = replay(folder, work)
    if played.note:
        print_line(played.note)
    table = Table("slot", "arrays", "agrees", "differs most")
    for one in played.agreements:
        table.add_row(one.slot, str(one.n_arrays), _words(one), one.array if one.largest > 0 else "")
    Console().print(table)
    for name, value in played.metrics.items():
        print_line(f"{name} {value:.4g}, then {played.expected.get(name, float('nan')):.4g}")
    print_line("the same as when the case was made" if played.same else "not the same as when the case was made")
    return 0 if played.same else 1


def _words(one: Agreement) -> str:
    if one.largest == 0:
        return "the same bytes"
    if one.largest == float("inf"):
        return "another shape, or other gaps"
    how = "but for rounding" if one.largest <= CLOSE else "NO"
    return f"{how}: {one.largest:.2g} of its range"
