"""How long from a typed command to an answer: the help, and the window's first paint and six finished columns?

Run under a display: python benchmarks/startup.py (without one: xvfb-run -a -s "-screen 0 1600x950x24" python ...).
Promises: help under 0.4 s, window visible under 3 s on a warm machine. Each is a new process.
"""

from __future__ import annotations

import math
import os
import subprocess
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from pipeline.racing.races import Answer, Bar, row, timing
from pipeline.racing.report import show

NEEDS = "a display"
REPEATS = 5
SCRIPT = Path(sys.executable).with_name("tactoscope")
WINDOW = """
import time
from app import main
main.prepare_environment()
from PyQt6.QtCore import QEvent, QObject
from app.session import Session
from app.tour import wait_until_shown
application = main.make_application()
instrument = main.show_window(Session(recording=main.SAMPLE))
class FirstPaint(QObject):
    seen = 0.0
    def eventFilter(self, watched, event):
        if event.type() == QEvent.Type.Paint and not self.seen:
            self.seen = time.time()
        return False
paint = FirstPaint()
instrument.window.installEventFilter(paint)
while not paint.seen:
    application.processEvents()
wait_until_shown(instrument)
print(paint.seen, time.time(), flush=True)
instrument.window.close()
"""


def help_ms():
    started = time.time()
    subprocess.run([SCRIPT, "--help"], check=True, capture_output=True)
    return 1e3 * (time.time() - started)


def window_ms():
    """(until the first paint, until six columns are finished)."""
    started = time.time()
    done = subprocess.run([sys.executable, "-c", WINDOW], check=True, capture_output=True, text=True)
    return tuple(1e3 * (float(word) - started) for word in done.stdout.split())


def answer() -> Answer:
    screen = any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "QT_QPA_PLATFORM"))
    help_ms()  # files in memory
    taken = {"tactoscope --help": ([help_ms() for _ in range(REPEATS)], Bar(ms=400))}
    if screen:
        window_ms()  # kernels compiled
        windows = [window_ms() for _ in range(REPEATS)]
        taken["window painted"] = ([w[0] for w in windows], Bar(ms=3000))
        taken["six columns finished"] = ([w[1] for w in windows], Bar())
    rows = tuple(row(name, ours=timing(ms), ours_error=math.nan, unit="", bar=bar) for name, (ms, bar) in taken.items())
    notes = () if screen else ("there is no display: the window was not opened",)
    return Answer(title="From a typed command to an answer", unit="", rows=rows, notes=notes)


if __name__ == "__main__":
    show(answer())
