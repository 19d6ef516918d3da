"""Panels that other installed packages add to the Diagnostics drawer, by the entry point group `tactoscope.panels`."""

import logging
from collections.abc import Callable
from dataclasses import dataclass

from PyQt6.QtWidgets import QWidget

from app.window.session_controller import SessionController
from pipeline.base.entry_points import load_entry_points

log = logging.getLogger("tactoscope")


@dataclass(frozen=True, slots=True, kw_only=True)
class Panel:
    """A tab of the Diagnostics drawer."""

    title: str
    build: Callable[[SessionController], QWidget]  # called once, and connects the widget with the session


def add_panels(controller: SessionController) -> None:
    """Add the panels of installed packages; one that cannot be built is left out with a warning in the log."""
    for panel in load_entry_points("tactoscope.panels"):
        try:
            controller.window.tabs.addTab(panel.build(controller), panel.title)
        except Exception as error:  # noqa: BLE001 - a border: another package's code may raise anything
            log.warning("tactoscope.panels: the panel %r cannot be built (%s); it is left out", panel, error)
