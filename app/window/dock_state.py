"""What of the window can be dragged, as a value and back: drawers, tool bars, handles between views."""

from __future__ import annotations

from collections.abc import Mapping

from PyQt6.QtCore import QByteArray
from PyQt6.QtWidgets import QMainWindow, QSplitter

from app.session.layout import Arrangement
from widgets.pane_splitter import PaneSplitter
from widgets.stage_rows import StageRows


def capture_arrangement(window: QMainWindow, name: str, alone: str) -> Arrangement:
    """How the window stands, under a name."""
    docks = bytes(window.saveState().toBase64().data()).decode("ascii")
    splits = {key: tuple(split.sizes()) for key, split in _splits(window).items() if _dragged(split)}
    return Arrangement(name, only_stage=alone, dock_state=docks, splitter_sizes_px=splits)


def restore_arrangement(window: QMainWindow, own: Arrangement) -> bool:
    """Have it stand so; False where the drawers are of another version of the window, and stay as they are."""
    same = window.restoreState(QByteArray.fromBase64(QByteArray(own.dock_state.encode("ascii", "replace"))))
    for key, split in _splits(window).items():
        sizes = own.splitter_sizes_px.get(key, ())
        if isinstance(split, StageRows | PaneSplitter):
            split.restore_sizes(sizes)
        elif len(sizes) == split.count():
            split.setSizes(list(sizes))
    return same


def _splits(window: QMainWindow) -> Mapping[str, QSplitter]:
    found = window.findChildren(QSplitter)
    return {split.objectName(): split for split in found if split.objectName().startswith("split_")}


def _dragged(split: QSplitter) -> bool:
    return split.isVisible() and (not isinstance(split, StageRows | PaneSplitter) or split.is_user_sized)
