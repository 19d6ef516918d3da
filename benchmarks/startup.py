"""How long from a typed command to an answer: the help, and the window's first paint and six finished columns?

Run under a display: python benchmarks/startup.py (without one: xvfb-run -a -s "-screen 0 1600x950x24" python ...).
Promises: help under 0.4 s, window visible under 3 s on a warm machine. Each is a new process; medians of 5.
"""

from __future__ import annotations

import statistics
import subprocess
import sys
import time
from pathlib import Path

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


def help_s():
    started = time.time()
    subprocess.run([SCRIPT, "--help"], check=True, capture_output=True)
    return time.time() - started


def window_s():
    started = time.time()
    done = subprocess.run([sys.executable, "-c", WINDOW], check=True, capture_output=True, text=True)
    painted, finished = (float(word) for word in done.stdout.split())
    return painted - started, finished - started


def main():
    help_s(), window_s()  # files in memory, kernels compiled
    helps = [help_s() for _ in range(REPEATS)]
    windows = [window_s() for _ in range(REPEATS)]
    rows = {
        "tactoscope --help": helps,
        "window painted": [w[0] for w in windows],
        "six columns finished": [w[1] for w in windows],
    }
    print(f"{'what':24s} {'median s':>9s} {'largest s':>9s}")
    for what, seconds in rows.items():
        print(f"{what:24s} {statistics.median(seconds):9.2f} {max(seconds):9.2f}")


if __name__ == "__main__":
    main()
