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
from widgets.section_line_tool import SectionHand

kept, armed = [], []

class Busy(SectionHand):  # PyQt's table of all objects is laid anew while it walks through it
    def eventFilter(self, watched, event):
        if armed:
            kept.extend(QPoint() for _ in range(200))
        return super().eventFilter(watched, event)

atexit.register(armed.append, True)  # after what the application does at the end, before what PyQt does
application = make_application()
instrument = show_window(Session(), with_scene=False)
hands = [Busy(column.view.canvas) for column in instrument.window.columns.values()]
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
from pipeline.sensors.offsets import Offsets
from pipeline.translation.translate import Request

shown = main.show_window

def show_window(*args, **kwargs):
    instrument = shown(*args, with_scene=False, **kwargs)

    def work():
        if instrument.views.opened is None or not instrument.idle:
            return
        every.stop()
        instrument.window.actions_by_name["section_line"].trigger()
        instrument.change("move", offsets=Offsets(shift_mm=(1.5, 0.0, 0.0)))
        print("ready", flush=True)
        QMessageBox.information(instrument.window, "asks", "and waits")

    every = QTimer(instrument)
    every.timeout.connect(work)
    every.start(20)
    return instrument

main.show_window = show_window
tour = Path(sys.argv[2]) if len(sys.argv) > 2 else None
sys.exit(main.open_window(Request(recording=Path(sys.argv[1]), target="gelslim"), frame=2, tour=tour))
"""


@contextmanager
def _run(script: str, *words: object, home: Path) -> Iterator[subprocess.Popen[str]]:
    places = {"XDG_CONFIG_HOME": str(home), "XDG_STATE_HOME": str(home), "PYTHONPATH": str(Path.cwd())}
    command = [sys.executable, "-c", script, *map(str, words)]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, env={**os.environ, **places}, stdout=pipe, stderr=pipe, text=True) as running:
        try:
            yield running
        finally:
            running.kill()  # one that did not end


def test_a_window_that_nobody_destroyed_does_not_end_the_process_with_a_crash(tmp_path):
    with _run(_NEVER_DESTROYED, home=tmp_path) as running:
        _, told = running.communicate(timeout=30)
    assert running.returncode == 0, told[-2000:]


def test_ctrl_c_closes_the_window_and_what_was_edited_is_kept(touch_file, remembered_here):
    """With its section line on, and a dialog that waits for an answer."""
    with _run(_ENDED, touch_file, home=remembered_here) as running:
        assert running.stdout.readline() == "ready\n"
        running.send_signal(signal.SIGINT)
        _, told = running.communicate(timeout=30)
    assert (running.returncode, told) == (128 + signal.SIGINT, "")
    (left,) = recovery.find_recoverable_sessions(recovery.get_recovery_folder())
    assert left.session.offsets.translation_mm == (1.5, 0.0, 0.0)
    assert left.session.section is not None


def test_a_tour_that_is_told_to_end_ends(touch_file, tmp_path):
    with _run(_ENDED, touch_file, tmp_path / "tour", home=tmp_path) as running:
        assert running.stdout.readline() == "ready\n"
        running.send_signal(signal.SIGTERM)
        _, told = running.communicate(timeout=30)
    assert (running.returncode, told) == (128 + signal.SIGTERM, "")
