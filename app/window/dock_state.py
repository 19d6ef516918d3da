"""Capture and restore of docks, tool bars and splitters."""

from __future__ import annotations

from collections.abc import Mapping

from PyQt6.QtCore import QByteArray
from PyQt6.QtWidgets import QMainWindow, QSplitter

from app.session.layout import Arrangement
from widgets.pane_splitter import PaneSplitter
from widgets.stage_rows import StageRows


def capture_arrangement(window: QMainWindow, name: str, only_stage: str) -> Arrangement:
    """Capture docks, tool bars and dragged splitters under a name."""
    docks = bytes(window.saveState().toBase64().data()).decode("ascii")
    sizes_px = {key: tuple(split.sizes()) for key, split in _find_splitters(window).items() if _is_dragged(split)}
    return Arrangement(name, only_stage=only_stage, dock_state=docks, splitter_sizes_px=sizes_px)


def restore_arrangement(window: QMainWindow, arrangement: Arrangement) -> bool:
    """Restore an arrangement; returns False if its docks are of another version and stay unchanged."""
    restored = window.restoreState(QByteArray.fromBase64(QByteArray(arrangement.dock_state.encode("ascii", "replace"))))
    for key, split in _find_splitters(window).items():
        sizes = arrangement.splitter_sizes_px.get(key, ())
        if isinstance(split, StageRows | PaneSplitter):
            split.restore_sizes(sizes)
        elif len(sizes) == split.count():
            split.setSizes(list(sizes))
    return restored


def _find_splitters(window: QMainWindow) -> Mapping[str, QSplitter]:
    splitters = window.findChildren(QSplitter)
    return {split.objectName(): split for split in splitters if split.objectName().startswith("split_")}


def _is_dragged(split: QSplitter) -> bool:
    return split.isVisible() and (not isinstance(split, StageRows | PaneSplitter) or split.is_user_sized)
