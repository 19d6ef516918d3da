"""How fast are data sets made: moments a second on disk, with one process and with two?

Run: python benchmarks/simulator_throughput.py [POSES]. Each row simulates and writes POSES (6) grasps of each of three
training objects, noise and truth included; a moment is one reading of every sensor named. Warm: each worker has made
a moment before. The bar is ours: 12 objects x 60 grasps x 3 sensors within ten minutes.
"""

from __future__ import annotations

import contextlib
import math
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.races import Bar, row, timing
from pipeline.racing.races import Answer
from pipeline.racing.report import show
from pipeline.simulation import datasets, shapes
from pipeline.simulation.datasets import Plan
from pipeline.simulation.recorder import record, workers

SENSOR_SETS = (
    ("gelslim", "soft_bubble"),
    ("digit",),
    ("gelsight_mini",),
    ("gelslim", "digit", "soft_bubble"),
)
N_OBJECTS = 3
N_MOMENTS = 12 * 60
BAR = Bar(ms=10 * 60e3 / N_MOMENTS)


def moments_per_s(sensors, n, jobs):
    like = Plan(sensors=sensors, tool="", poses=n, seed=0)
    plans = datasets.plans(shapes.names("training")[:N_OBJECTS], like)
    warm_up = datasets.plans(shapes.names("training")[:1], Plan(sensors=sensors, tool="", poses=4 * jobs, seed=1))[0]
    with tempfile.TemporaryDirectory() as folder, workers(jobs) if jobs > 1 else contextlib.nullcontext() as pool:
        record(warm_up, Path(folder) / "warm_up.h5", pool=pool)
        started = time.perf_counter()
        for plan in plans:
            record(plan, Path(folder) / f"{plan.thing_name}.h5", pool=pool)
        seconds = time.perf_counter() - started
        size = sum(f.stat().st_size for f in Path(folder).glob("*.h5") if f.name != "warm_up.h5")
    return n * len(plans) / seconds, size / (n * len(plans))


def answer(n: int = 6) -> Answer:
    rows, notes = [], []
    for sensors in SENSOR_SETS:
        (alone, size), (two, _) = moments_per_s(sensors, n, 1), moments_per_s(sensors, n, 2)
        rows.append(row(f"a moment of {', '.join(sensors)}", peer="one process", ours=timing([1e3 / two]),
                        peer_timing=timing([1e3 / alone]), ours_error=math.nan, unit="", bar=BAR))  # fmt: skip
        notes.append(f"{', '.join(sensors)}: {two:.2f} moments a second, {size / 1e3:.0f} kB each, "
                     f"{N_MOMENTS} in {N_MOMENTS / two / 60:.1f} min")  # fmt: skip
    return Answer(title="Data sets, two processes beside one", unit="", rows=tuple(rows), notes=tuple(notes))


if __name__ == "__main__":
    show(answer(*(int(n) for n in sys.argv[1:2])))
