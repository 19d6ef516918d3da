"""What does the window's own code cost on the GUI thread while a recording plays? The promise: nothing over 16 ms.

Run under a display: python benchmarks/window_slots.py [RECORDING TARGET SOURCE]. Our own slots are timed; what VTK and
Qt draw is in the event loop's blocks, which software OpenGL makes long.
"""

from __future__ import annotations

import math
import statistics
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.races import Bar, Timing, row
from pipeline.racing.races import Answer
from pipeline.racing.report import show

NEEDS = "a display"
PLAYED_S = 20.0


def answer(*given: str) -> Answer:
    from app import main as app_main

    app_main.prepare_environment()
    from app.frame.tour import wait_until_shown
    from app.session.state import Session

    given = given or (str(app_main.SAMPLE), "soft_bubble", "gelslim")
    application = app_main.make_application()
    instrument = app_main.show_window(Session(recording=Path(given[0]), target=given[1], source=given[2], frame=0))
    wait_until_shown(instrument)
    instrument.watch.taken_ms.clear()
    shown, blocks_ms = set(), []
    instrument.frame_shown.connect(shown.add)
    instrument.choose_frame(0)
    wait_until_shown(instrument)
    instrument.window.timeline.play(on=True)
    begun = time.perf_counter()
    while instrument.window.timeline.playing and time.perf_counter() - begun < PLAYED_S:
        started = time.perf_counter()
        application.processEvents()
        blocks_ms.append(1e3 * (time.perf_counter() - started))
        time.sleep(0.0005)
    taken_ms = dict(instrument.watch.taken_ms)
    instrument.window.close()
    rows = tuple(
        # The longest stands where a median would: the promise is about every single one.
        row(f"slot {name}, longest", ours=Timing(median_ms=ms, p95_ms=ms), ours_error=math.nan, unit="", bar=Bar(ms=16))
        for name, ms in ((name, max(kept)) for name, kept in taken_ms.items())
    )
    notes = (
        f"{len(shown)} frames shown; longest block of the event loop, drawing included: {max(blocks_ms):.0f} ms",
        "medians in ms: " + ", ".join(f"{name} {statistics.median(kept):.2f}" for name, kept in taken_ms.items()),
    )
    return Answer(title="The window's own code while a recording plays", unit="", rows=rows, notes=notes)


if __name__ == "__main__":
    show(answer(*(sys.argv[1:4] if len(sys.argv) > 3 else ())))
