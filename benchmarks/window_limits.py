"""How soon does the window respond and what does it need at rest: first pane, draft, cancel, idle,
memory?

Run under a display: python -m benchmarks.window_limits [FRAME CHANGES]. Waiting is reported by the
wall clock, and as the processor's time of the whole process meanwhile, which a busy machine does
not lengthen; the bars are on the latter. Memory is the process's largest resident size over frame
changes in twenty-eight openings: each sample both ways, and all of that once more. What is loaded
once, and stores that fill up to their bounds, come in the first fourteen, whose own second half is
reported too; what grows after them, with the very same on screen, is a leak.
"""

from __future__ import annotations

import math
import resource
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.harness.results import BenchmarkResult, Measurement
from benchmarks.harness.text_report import print_result
from benchmarks.harness.timing import Requirement, Timing, build_measurement
from benchmarks.window_events import rest, spin

NEEDS = "a display"
CHANGES = 1000
PASSES = 2
NEW_FRAMES = 8
DRAGS = 8
CANCELS = 6
IDLE_S = 10.0
ANSWER_MS = 100.0
IDLE_PERCENT = 1.0
MOST_MB = 800.0
GROWTH_MB = 50.0
_LIMIT_S = 60.0
_WARM_UP = 2  # the first ones load and compile


def measure(*given: str) -> BenchmarkResult:
    changes = int(given[0]) if given else CHANGES
    from app import main as app_main

    app_main.prepare_environment()
    application = app_main.make_application()
    from app.session.state import Session

    instrument = app_main.show_window(
        Session(
            recording=app_main.SAMPLE_RECORDING, source="gelslim", target="soft_bubble", frame=5
        )
    )
    instrument.window.resize(1600, 950)
    instrument.window.may_close = lambda: True
    spin(instrument, application)
    notes: list[str] = []
    rows = [
        _waits("new frame to its first pane", notes, _new_frames(instrument, application)),
        _waits("parameter slider to its stage's preview", notes, _drafts(instrument, application)),
        _waits("alignment slider to the preview", notes, _previews(instrument, application)),
        _waits("cancel", notes, _cancels(instrument, application)),
        _idle(instrument, application, notes),
        *_memory(instrument, application, changes, notes),
    ]
    app_main.close_window(instrument)
    return BenchmarkResult(
        title="What the window answers and takes", unit="", rows=tuple(rows), notes=tuple(notes)
    )


def _wait(application: Any, until: Callable[[], bool]) -> tuple[float, float]:
    """Wall and processor's milliseconds until something holds."""
    begun_s = time.perf_counter()
    begun_cpu_s = time.process_time()
    while not until() and time.perf_counter() - begun_s < _LIMIT_S:
        application.processEvents()
        time.sleep(0.0003)
    return 1e3 * (time.perf_counter() - begun_s), 1e3 * (time.process_time() - begun_cpu_s)


def _waits(name: str, notes: list[str], waits: list[tuple[float, float]]) -> Measurement:
    wall, cpu = np.array(waits[_WARM_UP:]).T
    notes.append(
        f"{name}: processor median {np.median(cpu):.0f}, largest {cpu.max():.0f} ms; "
        f"wall clock median {np.median(wall):.0f}, largest {wall.max():.0f} ms, of {len(cpu)}"
    )
    taken = Timing(median_ms=float(np.median(cpu)), p95_ms=float(np.percentile(cpu, 95)))
    return build_measurement(
        name, ours=taken, ours_error=math.nan, unit="", bar=Requirement(max_ms=ANSWER_MS)
    )


def _new_frames(instrument: Any, application: Any) -> list[tuple[float, float]]:
    waits = []
    for index in range(6, 6 + NEW_FRAMES):
        source = instrument.views.get_shown_stage("source")
        instrument.choose_frame(index)
        waits.append(
            _wait(
                application,
                lambda old=source: instrument.views.get_shown_stage("source") is not old,
            )
        )
        spin(instrument, application)
    return waits


def _drafts(instrument: Any, application: Any) -> list[tuple[float, float]]:
    from pipeline.core.params import replace_value
    from pipeline.stages.depth.stage import PHYSICS

    waits = []
    panel = instrument.window.parameters
    panel.slider_held.emit(PHYSICS.key)
    for n in range(DRAGS):
        depth = instrument.views.get_shown_stage("depth")
        params = replace_value(
            instrument.session.get_params(PHYSICS), "sensitivity", 1.0 + 0.02 * (n + 1)
        )
        instrument.choose_params(PHYSICS.key, params)
        waits.append(
            _wait(
                application, lambda old=depth: instrument.views.get_shown_stage("depth") is not old
            )
        )
        spin(instrument, application)
    panel.slider_held.emit("")
    instrument.change("back", params={})
    spin(instrument, application)
    return waits


def _previews(instrument: Any, application: Any) -> list[tuple[float, float]]:
    window = instrument.window
    window.drawers.alignment.show()
    spin(instrument, application)
    slider = window.alignment.rows["x"].slider
    view = window.columns["target_depth"]
    waits = []
    slider.setSliderDown(True)
    for n in range(DRAGS):
        old = view.view.preview
        slider.setValue(slider.value() + 3 + n)
        waits.append(
            _wait(
                application,
                lambda old=old: view.state == "preview" and view.view.preview is not old,
            )
        )
    slider.setSliderDown(False)
    spin(instrument, application)
    instrument.undo_stack.undo()
    window.drawers.alignment.hide()
    spin(instrument, application)
    return waits


def _cancels(instrument: Any, application: Any) -> list[tuple[float, float]]:
    """Of frames on their way, asked a little later each time."""
    waits = []
    for n in range(CANCELS + _WARM_UP):
        instrument.evaluator.graph.cache.clear()  # so that there is something to stop
        instrument.choose_frame(n % 4)
        _wait(application, lambda: instrument.job.is_busy)
        end_s = time.perf_counter() + 0.02 * (n + 1)
        while time.perf_counter() < end_s:
            application.processEvents()
        instrument.cancel()
        waits.append(_wait(application, lambda: not instrument.job.is_busy))
    instrument.refresh()
    spin(instrument, application)
    return waits


def _idle(instrument: Any, application: Any, notes: list[str]) -> Measurement:
    """The share of one core that an open window takes while nobody touches it."""
    from PyQt6.QtCore import QEventLoop, QTimer

    # the errors of all frames are computed as long as some are not known
    rest(instrument, application)
    loop = QEventLoop()
    QTimer.singleShot(round(1e3 * IDLE_S), loop.quit)
    begun_s = time.process_time()
    loop.exec()
    percent = 100 * (time.process_time() - begun_s) / IDLE_S
    notes.append(f"idle for {IDLE_S:g} s: {percent:.2f} % of one core")
    return build_measurement(
        "idle, share of one core",
        ours=_NO_TIME,
        ours_error=percent,
        unit="%",
        bar=Requirement(max_error=IDLE_PERCENT),
    )


def _memory(instrument: Any, application: Any, changes: int, notes: list[str]) -> list[Measurement]:
    from app import main as app_main

    rng = np.random.default_rng(0)
    held_mb = []
    recordings = sorted(app_main.SAMPLE_RECORDING.parent.glob("*.h5"))
    openings = [
        (path, swap) for _ in range(PASSES) for swap in (False, True) for path in recordings
    ]
    done = 0
    for opening, (path, swap) in enumerate(openings):
        _open(instrument, path, swap=swap)
        n = instrument.views.translation.n_frames
        for _ in range(changes * (opening + 1) // len(openings) - done):
            instrument.choose_frame(int(rng.integers(min(n, 12))))
            spin(instrument, application)
            done += 1
        held_mb.append(_resident_mb())
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    once = len(held_mb) // PASSES
    # each next to the time before: the same is on screen
    gained = np.array(held_mb[once:]) - held_mb[:once]
    # those whose like came when all of a kind had been seen once
    growth = float(gained[once // 2 :].mean())
    notes.append(
        f"memory after each of {len(held_mb)} openings, {done} frame changes, MB: "
        + " ".join(f"{mb:.0f}" for mb in held_mb)
    )
    filled = held_mb[once - 1] - held_mb[once // 2]
    notes.append(f"the second half of the first pass alone, while stores fill: {filled:.0f} MB")
    figures = (
        ("memory, largest", most, MOST_MB),
        ("memory, growth over a second pass", growth, GROWTH_MB),
    )
    return [
        build_measurement(
            name, ours=_NO_TIME, ours_error=mb, unit="MB", bar=Requirement(max_error=limit_mb)
        )
        for name, mb, limit_mb in figures
    ]


def _open(instrument: Any, path: Path, *, swap: bool) -> None:
    """A recording as it was recorded, or from its target's sensor to its source's."""
    from app.shell.tour import wait_until_shown

    instrument.change("as recorded", target="")
    instrument.open_path(path)
    wait_until_shown(instrument, _LIMIT_S)
    if swap and instrument.views.translation is not None:
        t = instrument.views.translation
        instrument.change("swap", source=t.target.name, target=t.source.name, stream="")
        wait_until_shown(instrument, _LIMIT_S)


_NO_TIME = Timing(median_ms=math.nan, p95_ms=math.nan)


def _resident_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 2**20


if __name__ == "__main__":
    print_result(measure(*sys.argv[1:]))
