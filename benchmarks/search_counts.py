"""What is each count of the pose's search worth? Poses missed, and time, with half of it and with twice as much.

    python benchmarks/search_counts.py [PART OF A NAME]

Training objects are pressed into a simulated DIGIT, twice each, and their true membranes get 0.03 mm of noise; every
touch is searched anew. Found means that the pose, or one that is told to fit equally well, is within 0.5 mm and 3
degrees of the truth at the contact's middle, in the motions that it calls determined and up to the object's symmetry:
a rod may lie anywhere along itself. The peer of a count is its half or its double, whichever misses fewer and, of
equals, is quicker: what stands in the code is right where neither misses fewer, nor as few in nine tenths of the time.
Time is of the processor; the three take turns on every touch.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.timing import Requirement, build_measurement, summarize_times
from pipeline.base.arrays import freeze
from pipeline.geometry import rigid
from pipeline.metrics.symmetric_pose_error import compute_symmetric_error
from pipeline.racing.results import BenchmarkResult
from pipeline.racing.text_report import print_result
from pipeline.registration import search
from pipeline.sensors.spec import load_sensor
from pipeline.simulation import shapes
from pipeline.simulation.press import simulate_press
from pipeline.stages.pose.signed_distances import PoseParams, estimate_pose
from pipeline.values.pixel_index import make_pixel_index
from pipeline.values.results import DepthMap

NEEDS = "fifteen minutes"
COUNTS = (
    "_COARSE_FELT", "_MIDDLE_FELT", "_MIDDLE_MODEL", "_FINE_FELT", "_FINE_MODEL", "_OUTLINE_FELT", "_OUTLINE_MODEL",
    "_POLISH_POINTS", "_DENSE_FELT", "_DENSE_MODEL", "_PER_GROUP", "_N_REGISTERED", "_N_POLISHED", "_N_DENSE",
    "_QUICK_POINTS", "_QUICK_ITERATIONS",
)  # fmt: skip
_NOISE_MM, _FOUND_MM, _FOUND_DEG, _DEPTHS_MM = 0.03, 0.5, 3.0, (0.4, 0.8)
_PARAMS = PoseParams(keep_steps=False)


def touches():
    """(felt touch, object, true sensor_from_object) of every training object, on its own side and tilted."""
    told = load_sensor("digit")
    for index, name in enumerate(shapes.list_shapes("training")):
        thing = shapes.make_shape(name)
        for depth_mm in _DEPTHS_MM:
            rng = np.random.default_rng([index, round(100 * depth_mm)])
            at = rigid.rotation((*rng.uniform(-0.07, 0.07, 2), rng.uniform(-np.pi, np.pi)))
            at[2, 3] = -depth_mm - rigid.apply(at, thing.mesh.vertices_mm)[:, 2].min()
            found = simulate_press(thing.mesh, at, told, seed=index)
            if not (found.converged and found.truth.contact.any()):
                continue
            moved = found.truth.indentation_mm + _NOISE_MM * rng.standard_normal(told.camera.shape)
            yield DepthMap(
                indentation_mm=freeze(moved.astype(np.float32)), contact=found.truth.contact, camera=told.camera,
                depth_mm=freeze((told.rest_depth_mm - moved).astype(np.float32)),
                source_index=make_pixel_index(told.camera.shape),
            ), thing, found.truth.sensor_from_object  # fmt: skip


def measure_search(case) -> tuple[bool, float]:
    """(whether it is missed, milliseconds)."""
    felt, thing, truth = case
    began_s = time.process_time()
    found = estimate_pose(felt, thing.mesh, _PARAMS)
    taken_ms = 1e3 * (time.process_time() - began_s)
    if found.sensor_from_object is None or found.observable is None:
        return True, taken_ms
    middle = found.scene_mm.mean(axis=0)
    off = [
        compute_symmetric_error(p, truth, thing.mesh, thing.symmetry, middle, found.observable)
        for p in (found.sensor_from_object, *found.alternatives)
    ]
    return all(e.observable_mm > _FOUND_MM or e.observable_deg > _FOUND_DEG for e in off), taken_ms


def vary_count(name: str, cases) -> dict[int, tuple[float, list[float]]]:
    """(% missed, milliseconds of each) by the count's half, itself and its double."""
    value = getattr(search, name)
    taken: dict[int, list[tuple[bool, float]]] = {n: [] for n in (max(value // 2, 1), value, 2 * value)}
    try:
        for case in cases:
            for other, found in taken.items():
                setattr(search, name, other)
                found.append(measure_search(case))
    finally:
        setattr(search, name, value)
    return {n: (100.0 * float(np.mean([m for m, _ in found])), [ms for _, ms in found]) for n, found in taken.items()}


def measure(part: str = "") -> BenchmarkResult:
    cases = list(touches())
    for case in cases:
        measure_search(case)  # compiled, and grids at hand
    rows = []
    for name in (n for n in COUNTS if part in n):
        value, beside = getattr(search, name), vary_count(name, cases)
        usual, usual_ms = beside.pop(value)
        best = min(beside, key=lambda n: (beside[n][0], np.median(beside[n][1])))
        told = ", ".join(f"{n}: {missed:.1f} %, {np.median(ms):.0f} ms" for n, (missed, ms) in beside.items())
        bar = Requirement(min_error_ratio=1.0, min_speedup=0.9 if beside[best][0] == usual else None)
        rows.append(build_measurement(
            f"search.{name} = {value}", peer=told, ours=summarize_times(usual_ms), peer_timing=summarize_times(beside[best][1]),
            ours_error=usual, peer_error=beside[best][0], unit="% missed", bar=bar,
        ))  # fmt: skip
    return BenchmarkResult(title="Counts of the pose's search beside their half and double", unit="% missed", rows=tuple(rows),
                  notes=(f"{len(cases)} touches",))  # fmt: skip


if __name__ == "__main__":
    print_result(measure(*sys.argv[1:2]))
