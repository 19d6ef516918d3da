"""A panel of another package: a tab of the Diagnostics drawer, without an edit elsewhere."""

from __future__ import annotations

import importlib.metadata

import pytest
from PyQt6.QtWidgets import QLabel

from app.document.session_controller import SessionController
from app.shell.panels import Panel
from app.shell.tour import wait_until_shown
from pipeline.core import entry_points

LIMIT_S = 60.0
GROUP = "tactoscope.panels"


def build_counter(controller: SessionController) -> QLabel:
    """Show the number of the frame on screen."""
    label = QLabel()
    controller.frame_shown.connect(lambda index: label.setText(f"frame {index}"))
    return label


COUNTER = Panel(title="Counter", build=build_counter)
BROKEN = Panel(title="Broken", build=lambda _: 1 / 0)


@pytest.fixture
def installed(monkeypatch):
    entries = {
        name: importlib.metadata.EntryPoint(name, f"{__name__}:{name}", GROUP)
        for name in ("BROKEN", "COUNTER")
    }
    others = importlib.metadata.entry_points

    def list_entry_points(**selected):
        return list(entries.values()) if selected == {"group": GROUP} else others(**selected)

    monkeypatch.setattr(importlib.metadata, "entry_points", list_entry_points)
    entry_points.load_entry_points.cache_clear()
    yield
    entry_points.load_entry_points.cache_clear()


def test_a_panel_of_another_package_follows_the_frame(installed, open_window, touch_file, caplog):
    controller = open_window(touch_file, frame=1)
    assert wait_until_shown(controller, LIMIT_S), controller.window.banner.text
    tabs = controller.window.tabs
    titles = [tabs.tabText(i) for i in range(tabs.count())]
    assert titles[-1] == "Counter"
    assert tabs.widget(tabs.count() - 1).text() == "frame 1"
    assert "Broken" in caplog.text  # left out, and the window opens
