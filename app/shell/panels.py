"""Panels that other installed packages add to the Diagnostics drawer, by the entry point group
`tactoscope.panels`.
"""

from collections.abc import Callable

from PyQt6.QtWidgets import QWidget

from app.document.session_controller import SessionController
from pipeline.core.entry_points import call_package, load_entry_points
from pipeline.core.frozen import frozen


@frozen
class Panel:
    """A tab of the Diagnostics drawer."""

    title: str
    # called once, and connects the widget with the session
    build: Callable[[SessionController], QWidget]


def add_panels(controller: SessionController) -> None:
    """Add the panels of installed packages.

    One that cannot be built is left out with a warning in the log.
    """
    tabs = controller.window.tabs
    for panel in load_entry_points("tactoscope.panels", Panel):
        call_package(
            lambda panel=panel: tabs.addTab(panel.build(controller), panel.title),
            0,
            f"the panel {panel.title!r}",
        )
