"""How fast are data sets made: moments a second on disk, with one process and with two?

Run: python -m benchmarks.simulator_throughput [POSES]. Each row simulates and writes POSES (6) grasps of each of three
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

from benchmarks.harness.results import BenchmarkResult
from benchmarks.harness.text_report import print_result
from benchmarks.harness.timing import Requirement, build_measurement, summarize_times
from pipeline.simulation import datasets, shapes
from pipeline.simulation.datasets import SimulationPlan
from pipeline.simulation.recorder import make_worker_pool, record_plan

SENSOR_SETS = (
    ("gelslim", "soft_bubble"),
    ("digit",),
    ("gelsight_mini",),
    ("gelslim", "digit", "soft_bubble"),
)
N_OBJECTS = 3
N_MOMENTS = 12 * 60
BAR = Requirement(max_ms=10 * 60e3 / N_MOMENTS)


def moments_per_s(sensors, n, jobs):
    like = SimulationPlan(sensors=sensors, object_source="", n_poses=n, seed=0)
    plans = datasets.make_plans(shapes.list_shapes("training")[:N_OBJECTS], like)
    warm_up = datasets.make_plans(
        shapes.list_shapes("training")[:1], SimulationPlan(sensors=sensors, object_source="", n_poses=4 * jobs, seed=1)
    )[0]
    with (
        tempfile.TemporaryDirectory() as folder,
        make_worker_pool(jobs) if jobs > 1 else contextlib.nullcontext() as pool,
    ):
        record_plan(warm_up, Path(folder) / "warm_up.h5", pool=pool)
        started = time.perf_counter()
        for plan in plans:
            record_plan(plan, Path(folder) / f"{plan.object_name}.h5", pool=pool)
        seconds = time.perf_counter() - started
        size = sum(f.stat().st_size for f in Path(folder).glob("*.h5") if f.name != "warm_up.h5")
    return n * len(plans) / seconds, size / (n * len(plans))


def measure(n: int = 6) -> BenchmarkResult:
    rows, notes = [], []
    for sensors in SENSOR_SETS:
        (alone, size), (two, _) = moments_per_s(sensors, n, 1), moments_per_s(sensors, n, 2)
        rows.append(build_measurement(f"a moment of {', '.join(sensors)}", peer="one process", ours=summarize_times([1e3 / two]),
                        peer_timing=summarize_times([1e3 / alone]), ours_error=math.nan, unit="", bar=BAR))  # fmt: skip
        notes.append(f"{', '.join(sensors)}: {two:.2f} moments a second, {size / 1e3:.0f} kB each, "
                     f"{N_MOMENTS} in {N_MOMENTS / two / 60:.1f} min")  # fmt: skip
    return BenchmarkResult(title="Data sets, two processes beside one", unit="", rows=tuple(rows), notes=tuple(notes))


if __name__ == "__main__":
    print_result(measure(*(int(n) for n in sys.argv[1:2])))
