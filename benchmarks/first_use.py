"""How long is the first use: compiling kernels, the first touch of a new process, the window, the
help?

python -m benchmarks.first_use. Every figure is of new processes whose caches (numba's, and the
user's) are a folder of this run alone: empty for `tactoscope prepare`, as that leaves it for the
rest. The window opens on a display of its own (Xvfb: drawn without a GPU). Compiling is CPU time.
The rest is time on the clock, which a busy machine lengthens: the CPU time of the same processes
stands in a row without a bar.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.harness.results import BenchmarkResult, Measurement
from benchmarks.harness.text_report import print_result
from benchmarks.harness.timing import Requirement, build_measurement, summarize_times

ROOT = Path(__file__).resolve().parents[1]
SCRIPT = Path(sys.executable).with_name("tactoscope")
REPEATS = 3
LONGEST_S = 900.0
FRAME = 5  # a firm touch of every sensor of the sample
# every sensor on either side
WAYS = (("gelslim", "soft_bubble"), ("digit", "gelslim"), ("soft_bubble", "digit"))

COMPILED = """
import threading, time
from numba.core import event
class Compiled(event.Listener):
    def __init__(self):
        self.of = {}
        self.depth = threading.local()
    def on_start(self, event):
        d = self.depth
        d.now = getattr(d, "now", 0) + 1
        if d.now == 1:
            d.began, d.outermost = time.thread_time(), event.data["dispatcher"].py_func.__module__
        self.of.setdefault(d.outermost, [0, 0.0])[0] += 1
    def on_end(self, event):
        self.depth.now -= 1
        if self.depth.now == 0:
            self.of[self.depth.outermost][1] += time.thread_time() - self.depth.began
compiled = Compiled()
event.register("numba:compile", compiled)
"""
PREPARE = """
import json, sys, time
from pipeline.cli.prepare import prepare
prepare()
"""
CHAIN = """
import json, sys, time
from pathlib import Path
from pipeline.translation.translate import Request, open_translation
frame, ways = json.loads(sys.argv[1])
for source, target in ways:
    sample = Path("sample_data/recordings/first_touch.h5")
    opened = open_translation(Request(recording=sample, source=source, target=target))
    results = opened.evaluate(frame)
    assert {result.state for result in results.values()} == {"computed"}, "the touch was skipped"
"""
WINDOW = """
import json, sys, time
frame, ((source, target),) = json.loads(sys.argv[1])
from app import main
main.prepare_environment()
from PyQt6.QtCore import QEvent, QObject
from app.shell.tour import wait_until_shown
from app.session.state import Session
application = main.make_application()
class FirstPaint(QObject):
    seen = 0.0
    def eventFilter(self, watched, event):
        if event.type() == QEvent.Type.Paint and not self.seen:
            self.seen = time.time()
        return False
paint = FirstPaint()
application.installEventFilter(paint)
session = Session(
    recording=main.SAMPLE_RECORDING, source=source, target=target, frame=frame
)
instrument = main.show_window(session)
while not paint.seen:
    application.processEvents()
application.removeEventFilter(paint)
assert wait_until_shown(instrument), instrument.window.banner.text
shown = instrument.latest_frame
assert shown is not None and shown.index == frame, "the touch was not shown"
shown = time.time()
instrument.window.close()
instrument.close()
"""
TELL = """
import os
answer = {"cpu_s": sum(os.times()[:4]), "ended": time.time()}
answer["painted"], answer["shown"] = (paint.seen, shown) if "paint" in globals() else (0.0, 0.0)
answer["compiled"] = compiled.of if "compiled" in globals() else {}
print(json.dumps(answer), flush=True)
os._exit(0)  # what a library does on its way out is no first use
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class ProcessTimes:
    """What one new process says of itself."""

    total_s: float  # from its start to the answer
    cpu_s: float
    painted_s: float  # from its start to the window's first paint
    shown_s: float
    # module -> compilations that it asked for, their CPU seconds
    compiled: dict[str, tuple[int, float]]

    @property
    def n_compiled(self) -> int:
        """How many."""
        return sum(n for n, _ in self.compiled.values())

    @property
    def compiling_s(self) -> float:
        """How long in all, CPU seconds."""
        return sum(s for _, s in self.compiled.values())


def run_process(
    script: str, ways, caches: Path, *, watched: bool = False, display: str = ""
) -> ProcessTimes:
    """Run the script in a new process; its time counts from before the process is there."""
    environment = {
        name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"
    }
    environment |= {
        "NUMBA_CACHE_DIR": str(caches / "numba"),
        "XDG_CACHE_HOME": str(caches / "user"),
    }
    # kept as a user's Python keeps it
    environment["PYTHONPYCACHEPREFIX"] = str(caches / "bytecode")
    if display:
        environment |= {"DISPLAY": display, "QT_QPA_PLATFORM": "xcb"}
    code = (COMPILED if watched else "") + script + TELL
    began = time.time()
    done = subprocess.run(
        [sys.executable, "-c", code, json.dumps([FRAME, ways])],
        env=environment,
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=LONGEST_S,
        check=False,
    )
    if done.returncode:
        raise RuntimeError((done.stderr.strip().splitlines() or ["no answer"])[-1])
    said = json.loads(done.stdout.strip().splitlines()[-1])
    return ProcessTimes(
        total_s=said["ended"] - began,
        cpu_s=said["cpu_s"],
        painted_s=said["painted"] - began,
        shown_s=said["shown"] - began,
        compiled={name: tuple(v) for name, v in said["compiled"].items()},
    )


@contextlib.contextmanager
def start_display():
    """The name of a new X display of two screens' worth of pixels; "" where there is no Xvfb."""
    if shutil.which("Xvfb") is None:
        yield ""
        return
    read, write = os.pipe()
    server = subprocess.Popen(
        ["Xvfb", "-displayfd", str(write), "-screen", "0", "1600x950x24", "-nolisten", "tcp"],
        pass_fds=(write,),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    os.close(write)
    try:
        with os.fdopen(read) as number:
            yield ":" + number.readline().strip()
    finally:
        server.terminate()
        server.wait()


def help_ms() -> float:
    began = time.time()
    subprocess.run([SCRIPT, "--help"], check=True, capture_output=True)
    return 1e3 * (time.time() - began)


def select_times(
    name: str, taken_s, bar: Requirement, *, error: float = math.nan, unit: str = ""
) -> Measurement:
    return build_measurement(
        name, ours=summarize_times([1e3 * s for s in taken_s]), ours_error=error, unit=unit, bar=bar
    )


def measure_cache_mb(module: str) -> str:
    parts = module.split(".")
    return (
        ".".join(parts[1:3] if parts[1] == "stages" else parts[1:2])
        if parts[0] == "pipeline"
        else parts[0]
    )


def compiling(caches: Path) -> tuple[list[Measurement], list[str]]:
    """What the set-up compiles, with nothing kept, and what it leaves to the first touches of
    every sensor.
    """
    prepared = run_process(PREPARE, [], caches, watched=True)
    after = run_process(CHAIN, WAYS, caches, watched=True)
    rooms: dict[str, list[float]] = {}
    for module, (n, spent_s) in prepared.compiled.items():
        room = rooms.setdefault(measure_cache_mb(module), [0, 0.0])
        room[0] += n
        room[1] += spent_s
    each = ", ".join(
        f"{name} {s:.1f} s ({n:.0f})"
        for name, (n, s) in sorted(rooms.items(), key=lambda kv: -kv[1][1])
    )
    rows = [
        select_times(name, [run.compiling_s], bar, error=run.n_compiled, unit="compilations")
        for name, run, bar in (
            ("tactoscope prepare, CPU of compiling", prepared, Requirement(max_ms=40_000)),
            ("left to compile for every sensor on either side", after, Requirement(max_error=0)),
        )
    ]
    return rows, [
        f"compiled by room (compilations): {each}; the goal is 20 s",
        f"all of the set-up's process: {prepared.cpu_s:.1f} s of CPU",
    ]


def first_touch(caches: Path) -> list[Measurement]:
    runs = [run_process(CHAIN, WAYS[:1], caches) for _ in range(REPEATS)]
    unseen = list[ProcessTimes]()
    for _ in range(REPEATS):
        # of the recording, which was opened before
        shutil.rmtree(caches / "user" / "tactoscope" / "led_fits")
        unseen.append(run_process(CHAIN, WAYS[:1], caches))
    return [
        figure
        for name, touches, bar in (
            ("first touched frame of a new process", runs, Requirement(max_ms=2500)),
            ("the same of a recording that was never opened", unseen, Requirement()),
        )
        for figure in (
            select_times(name, [run.total_s for run in touches], bar),
            select_times(f"{name}, CPU", [run.cpu_s for run in touches], Requirement()),
        )
    ]


def window(caches: Path, display: str) -> tuple[list[Measurement], list[str]]:
    # warm, as at the second start
    once = run_process(WINDOW, WAYS[:1], caches, watched=True, display=display)
    runs = [run_process(WINDOW, WAYS[:1], caches, display=display) for _ in range(REPEATS)]
    rows = [
        select_times("window on screen", [run.painted_s for run in runs], Requirement(max_ms=1600)),
        select_times(
            "all columns of the first touch",
            [run.shown_s for run in runs],
            Requirement(max_ms=4000),
        ),
        select_times(
            "all columns of the first touch, CPU", [run.cpu_s for run in runs], Requirement()
        ),
    ]
    return rows, [
        f"compiled by the window beyond the chain: {once.n_compiled} ({once.compiling_s:.1f} s of "
        "CPU)"
    ]


def measure() -> BenchmarkResult:
    help_ms()  # files in memory
    rows = [
        select_times(
            "tactoscope --help",
            np.divide([help_ms() for _ in range(5)], 1e3),
            Requirement(max_ms=400),
        )
    ]
    notes = []
    with tempfile.TemporaryDirectory() as folder, start_display() as display:
        compiled, more = compiling(Path(folder))
        rows += [*compiled, *first_touch(Path(folder))]
        notes += more
        if display:
            some, more = window(Path(folder), display)
            rows += some
            notes += more
        else:
            notes.append("there is no Xvfb: the window was not opened")
    return BenchmarkResult(
        title="The first use, from nothing kept", unit="", rows=tuple(rows), notes=tuple(notes)
    )


if __name__ == "__main__":
    print_result(measure())
