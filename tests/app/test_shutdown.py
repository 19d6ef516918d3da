"""However the window ends, the process ends well and no edit is lost."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from app.session import recovery

_NEVER_DESTROYED = """
import atexit
from PyQt6.QtCore import QPoint, QPointF
from app.main import make_application, show_window
from app.session.state import Session
from widgets.stages.section_panel import SectionLineTool

kept, armed = [], []

class Busy(SectionLineTool):  # PyQt's table of all objects is laid anew while it walks through it
    def eventFilter(self, watched, event):
        if armed:
            kept.extend(QPoint() for _ in range(200))
        return super().eventFilter(watched, event)

atexit.register(armed.append, True)  # after what the application does at the end, before what PyQt does
application = make_application()
controller = show_window(Session(), with_scene=False)
hands = [Busy(column.view.canvas) for column in controller.window.columns.values()]
for hand in hands:
    hand.show_line((QPointF(0.0, 0.0), QPointF(5.0, 5.0)))
application.processEvents()
"""

_ENDED = """
import signal
import sys
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs ignore it, and so would this
from pathlib import Path
from PyQt6.QtCore import QTimer
from PyQt6.QtWidgets import QMessageBox
from app import main
from app.session.state import Session
from pipeline.sensors.alignment import Offsets
from pipeline.translation.translate import Request

shown = main.show_window

def show_window(*args, **kwargs):
    controller = shown(*args, with_scene=False, **kwargs)

    def work():
        if controller.views.translation is None or not controller.is_idle:
            return
        every.stop()
        controller.window.actions_by_name["section_line"].trigger()
        controller.change("move", offsets=Offsets(translation_mm=(1.5, 0.0, 0.0)))
        print("ready", flush=True)
        QMessageBox.information(controller.window, "asks", "and waits")

    every = QTimer(controller)
    every.timeout.connect(work)
    every.start(20)
    return controller

main.show_window = show_window
tour = Path(sys.argv[2]) if len(sys.argv) > 2 else None
sys.exit(main.open_window(Request(recording=Path(sys.argv[1]), target="gelslim"), frame=2, tour=tour))
"""


@contextmanager
def _run(script: str, *words: object, home: Path) -> Iterator[subprocess.Popen[str]]:
    places = {
        "XDG_CONFIG_HOME": str(home),
        "XDG_STATE_HOME": str(home),
        "PYTHONPATH": str(Path.cwd()),
    }
    command = [sys.executable, "-c", script, *map(str, words)]
    pipe = subprocess.PIPE
    with subprocess.Popen(
        command, env={**os.environ, **places}, stdout=pipe, stderr=pipe, text=True
    ) as running:
        try:
            yield running
        finally:
            running.kill()  # one that did not end


def test_a_window_that_was_not_destroyed_does_not_crash_at_exit(tmp_path):
    with _run(_NEVER_DESTROYED, home=tmp_path) as running:
        _, output = running.communicate()
    assert running.returncode == 0, output[-2000:]


def test_ctrl_c_closes_the_window_and_saves_the_recovery_file(touch_file, remembered_here):
    """With its section line on, and a dialog that waits for an answer."""
    with _run(_ENDED, touch_file, home=remembered_here) as running:
        assert running.stdout.readline() == "ready\n"
        running.send_signal(signal.SIGINT)
        _, output = running.communicate()
    assert (running.returncode, output) == (128 + signal.SIGINT, "")
    (left,) = recovery.find_recoverable_sessions(recovery.get_recovery_folder())
    assert left.session.offsets.translation_mm == (1.5, 0.0, 0.0)
    assert left.session.section is not None


def test_a_signal_ends_a_tour(touch_file, tmp_path):
    with _run(_ENDED, touch_file, tmp_path / "tour", home=tmp_path) as running:
        assert running.stdout.readline() == "ready\n"
        running.send_signal(signal.SIGTERM)
        _, output = running.communicate()
    assert (running.returncode, output) == (128 + signal.SIGTERM, "")
