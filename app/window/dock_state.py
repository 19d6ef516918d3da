"""Capture and restore of docks, tool bars and splitters.

Qt reads the state of docks without checking it, and damaged bytes end the process. So the state is signed with a key
of the user, and only what this user's program wrote is given to Qt.
"""

import base64
import hmac
from collections.abc import Mapping

from PyQt6.QtCore import QByteArray
from PyQt6.QtWidgets import QMainWindow, QSplitter

from app.session.layout import Arrangement
from app.session.preferences import Preferences
from widgets.styling import FittingSplitter


def capture_arrangement(window: QMainWindow, name: str, only_stage: str) -> Arrangement:
    """Capture docks, tool bars and dragged splitters under a name."""
    state = window.saveState().data()
    docks = f"{_sign(state)}:{base64.b64encode(state).decode('ascii')}"
    sizes_px = {key: tuple(split.sizes()) for key, split in _find_splitters(window).items() if _is_dragged(split)}
    return Arrangement(name, only_stage=only_stage, dock_state=docks, splitter_sizes_px=sizes_px)


def restore_arrangement(window: QMainWindow, arrangement: Arrangement) -> bool:
    """Restore an arrangement; returns False if its docks are of another version or user and stay unchanged."""
    state = _verify(arrangement.dock_state)
    restored = state is not None and window.restoreState(QByteArray(state))
    for key, split in _find_splitters(window).items():
        sizes = arrangement.splitter_sizes_px.get(key, ())
        if isinstance(split, FittingSplitter):
            split.restore_sizes(sizes)
        elif len(sizes) == split.count():
            split.setSizes(list(sizes))
    return restored


def _sign(state: bytes) -> str:
    return hmac.new(Preferences().signing_key, state, "sha256").hexdigest()


def _verify(text: str) -> bytes | None:
    """Return the state of docks in an arrangement; None unless this user's program wrote it."""
    signature, _, encoded = text.partition(":")
    try:
        state = base64.b64decode(encoded, validate=True)
        return state if hmac.compare_digest(signature, _sign(state)) else None
    except (ValueError, TypeError):  # no base64, or letters beyond ASCII
        return None


def _find_splitters(window: QMainWindow) -> Mapping[str, QSplitter]:
    splitters = window.findChildren(QSplitter)
    return {split.objectName(): split for split in splitters if split.objectName().startswith("split_")}


def _is_dragged(split: QSplitter) -> bool:
    return split.isVisible() and (not isinstance(split, FittingSplitter) or split.is_user_sized)
