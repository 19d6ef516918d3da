"""How the window starts."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from app.session.sample import SAMPLE_RECORDING
from app.session.state import AUTO_FRAME
from app.shell.tour import wait_until_shown


def test_a_recording_opens_on_a_touched_frame_whatever_comes_first(open_window, touch_file):
    """The sample begins untouched; so does what is opened later."""
    controller = open_window(SAMPLE_RECORDING, frame=AUTO_FRAME)
    assert wait_until_shown(controller, 240), controller.window.banner.text
    assert controller.latest_frame.results["depth"].output.contact.any()
    assert (
        controller.window.timeline.frame
        == controller.session.frame
        == controller.latest_frame.index
        > 0
    )
    controller.open_path(touch_file)
    assert wait_until_shown(controller, 240), controller.window.banner.text
    assert controller.session.frame == 2  # pressed deepest
    assert controller.latest_frame.results["depth"].output.contact.any()


_QUITS = """
import sys
from PyQt6.QtWidgets import QApplication

class Watched(QApplication):  # Python hears of every event, to the last
    def notify(self, receiver, event):
        return super().notify(receiver, event)

application = Watched(["tactoscope"])
QApplication.exec = staticmethod(lambda: 0)
from app.main import open_window
sys.exit(open_window(None))
"""


def test_the_process_exits_cleanly_after_its_window(tmp_path):
    """A window that outlived its application was called in the application's end, and the
    process crashed.
    """
    places = {
        "XDG_CONFIG_HOME": str(tmp_path),
        "XDG_STATE_HOME": str(tmp_path),
        "PYTHONPATH": str(Path.cwd()),
    }
    ended = subprocess.run(
        [sys.executable, "-c", _QUITS],
        env={**os.environ, **places},
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode == 0, ended.stderr[-2000:]


_CLOSED_AT_ONCE = """
import sys
from PyQt6.QtCore import QTimer
from app.main import make_application, open_window

application, timer = make_application(), QTimer(interval=1)
timer.timeout.connect(lambda: [window.close() for window in application.topLevelWidgets() if window.isVisible()])
timer.start()
sys.exit(open_window(None))
"""


def test_a_window_that_is_closed_while_it_is_made_ends_the_process(tmp_path):
    places = {
        "XDG_CONFIG_HOME": str(tmp_path),
        "XDG_STATE_HOME": str(tmp_path),
        "PYTHONPATH": str(Path.cwd()),
    }
    command = [sys.executable, "-c", _CLOSED_AT_ONCE]
    ended = subprocess.run(
        command,
        env={**os.environ, **places},
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert ended.returncode == 0, ended.stderr[-2000:]
