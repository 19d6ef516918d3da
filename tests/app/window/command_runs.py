"""What a window shows, held against what the command leaves that it copies."""

from __future__ import annotations

import shlex

from PyQt6.QtGui import QGuiApplication

from pipeline.cli.main import build_app, run_app
from pipeline.lab.evaluation.comparison_tiles import write_tiles


def same_as_typed(instrument, folder, monkeypatch) -> None:
    """The tiles on screen are, byte for byte, what the copied `tactoscope compare` writes."""
    monkeypatch.chdir(folder)
    instrument.window.actions_by_name["copy_command"].trigger()
    words = shlex.split(QGuiApplication.clipboard().text())
    assert words[:2] == ["tactoscope", "compare"]
    assert run_app(build_app(), words[1:]) == 0
    write_tiles(folder / "shown", instrument.window.comparison.current_tab.grid.tiles)
    shown, typed = (
        {p.name: p.read_bytes() for p in (folder / name).iterdir()}
        for name in ("shown", "compared")
    )
    assert shown.keys() == typed.keys()
    assert len(shown) > 2
    for name, data in shown.items():
        assert data == typed[name], name
