"""How fast are data sets made: moments a second on disk, with one process and with two?

Run: python benchmarks/simulator_throughput.py [POSES]. Each row simulates and writes POSES (12) grasps of each of three
training objects, noise and truth included; a moment is one reading of every sensor named. Warm: each worker has made
a moment before. Goal: 12 objects x 60 grasps x 3 sensors in minutes.
"""

from __future__ import annotations

import contextlib
import os
import platform
import sys
import tempfile
import time
from pathlib import Path

from pipeline.physics import datasets, shapes
from pipeline.physics.datasets import Plan
from pipeline.physics.recorder import record, workers

SENSOR_SETS = (
    ("gelslim", "soft_bubble"),
    ("digit",),
    ("gelsight_mini",),
    ("gelslim", "digit", "soft_bubble"),
)
N_OBJECTS = 3


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


def main():
    n = int(sys.argv[1]) if len(sys.argv) > 1 else 12
    print(f"{platform.processor() or platform.machine()}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}")
    print(f"{'sensors':32s} {'processes':>9s} {'moments/s':>10s} {'kB/moment':>10s} {'12 x 60 in min':>15s}")
    for sensors in SENSOR_SETS:
        for jobs in (1, 2):
            rate, size = moments_per_s(sensors, n, jobs)
            print(f"{', '.join(sensors):32s} {jobs:9d} {rate:10.2f} {size / 1e3:10.0f} {720 / rate / 60:15.1f}")


if __name__ == "__main__":
    main()
