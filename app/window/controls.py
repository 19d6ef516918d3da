"""Shows the session's values on the window's controls."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from PyQt6.QtCore import QSignalBlocker

from app.session.state import DISPLAY_KEY, Session
from app.window.main_window import MainWindow
from pipeline.engine.graph import Method
from pipeline.translation.catalogue import Catalogue


def show_controls(
    window: MainWindow, session: Session, methods: Sequence[Method], catalogue: Catalogue, kinds: Mapping[str, str]
) -> None:
    """Show a session with these methods on the controls, without change signals.

    `kinds` maps method keys to sensor kinds: only the parameters for that kind are shown.
    """
    window.timeline.show_frame(session.frame)
    window.frames.show_frame(session.frame)
    for stage in catalogue.stages:
        for method in stage.methods:
            window.parameters.show_params(method.key, session.get_params(method))
    window.parameters.show_params(DISPLAY_KEY, session.display)
    window.parameters.show_groups({**{m.key: kinds.get(m.key, "") for m in methods}, DISPLAY_KEY: ""})
    for method in methods:
        window.columns[method.stage].show_method(method.name)
    for name in ("source", "target", "route"):
        box, value = getattr(window, name), getattr(session, name)
        with QSignalBlocker(box):
            box.setCurrentIndex(max(0, box.findData(value)))
    window.actions_by_name["link_cameras"].setChecked(session.cameras_linked)
    window.actions_by_name["close_mesh"].setEnabled(session.mesh is not None)
    window.actions_by_name["close_weights"].setEnabled(bool(session.weights))
