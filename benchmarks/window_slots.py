"""What does the window's own code cost on the GUI thread while a recording plays? The promise: nothing over 16 ms.

Run under a display: python benchmarks/window_slots.py [RECORDING TARGET SOURCE]. Our own slots are timed; what VTK and
Qt draw is in the event loop's blocks, which software OpenGL makes long.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

from app import main as app_main

PLAYED_S = 20.0


def main():
    app_main.prepare_environment()
    from app.session import Session
    from app.tour import wait_until_shown

    given = sys.argv[1:4] if len(sys.argv) > 3 else [str(app_main.SAMPLE), "soft_bubble", "gelslim"]
    application = app_main.make_application()
    instrument = app_main.show_window(Session(recording=Path(given[0]), target=given[1], source=given[2], frame=0))
    wait_until_shown(instrument)
    instrument.watch.forget()
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
    print(f"{len(shown)} frames shown; longest block of the event loop, drawing included: {max(blocks_ms):.0f} ms")
    medians = instrument.watch.median_ms
    print(f"{'slot':24s} {'median ms':>10s} {'longest ms':>11s}")
    for name, longest in instrument.watch.longest_ms.items():
        print(f"{name:24s} {medians[name]:10.2f} {longest:11.2f}")
    instrument.window.close()


if __name__ == "__main__":
    main()
