"""What is each count of the pose's search worth? Poses missed, and time, with half of it and with twice as much.

    python benchmarks/search_counts.py [PART OF A NAME]

Training objects are pressed into a simulated DIGIT, twice each, and their true membranes get 0.03 mm of noise; every
touch is searched anew. Found means that the pose, or one that is told to fit equally well, carries no vertex of the
object farther than 0.5 mm off. The peer of a count is its half or its double, whichever misses fewer and, of equals, is
quicker: what stands in the code is right where neither misses fewer, nor as few in nine tenths of the time. Time is of
the processor.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.races import Bar, row, timing
from pipeline.base.arrays import freeze
from pipeline.evaluation.symmetric import symmetric_error
from pipeline.geometry import rigid
from pipeline.racing.races import Answer
from pipeline.racing.report import show
from pipeline.registration import search
from pipeline.sensors.spec import sensor
from pipeline.simulation import shapes
from pipeline.simulation.press import press
from pipeline.stages.pose.stage import PoseParams, pose
from pipeline.values.pixel_index import pixel_index
from pipeline.values.results import DepthMap

NEEDS = "ten minutes"
COUNTS = (
    "_COARSE_FELT", "_MIDDLE_FELT", "_MIDDLE_MODEL", "_FINE_FELT", "_FINE_MODEL", "_OUTLINE_FELT", "_OUTLINE_MODEL",
    "_POLISH_POINTS", "_DENSE_FELT", "_DENSE_MODEL", "_PER_GROUP", "_N_REGISTERED", "_N_POLISHED", "_N_DENSE",
    "_QUICK_POINTS", "_QUICK_ITERATIONS",
)  # fmt: skip
_NOISE_MM, _FOUND_MM, _DEPTHS_MM = 0.03, 0.5, (0.4, 0.8)
_PARAMS = PoseParams(keep_steps=False)


def touches():
    """(felt touch, mesh, true sensor_from_object) of every training object, on its own side and tilted."""
    told = sensor("digit")
    for index, name in enumerate(shapes.names("training")):
        thing = shapes.shape(name).mesh
        for depth_mm in _DEPTHS_MM:
            rng = np.random.default_rng([index, round(100 * depth_mm)])
            at = rigid.rotation((*rng.uniform(-0.07, 0.07, 2), rng.uniform(-np.pi, np.pi)))
            at[2, 3] = -depth_mm - rigid.apply(at, thing.vertices_mm)[:, 2].min()
            found = press(thing, at, told, seed=index)
            if not (found.converged and found.truth.contact.any()):
                continue
            moved = found.truth.indentation_mm + _NOISE_MM * rng.standard_normal(told.camera.shape)
            yield DepthMap(
                indentation_mm=freeze(moved.astype(np.float32)), contact=found.truth.contact, camera=told.camera,
                depth_mm=freeze((told.rest_depth_mm - moved).astype(np.float32)),
                source_index=pixel_index(told.camera.shape),
            ), thing, found.truth.sensor_from_object  # fmt: skip


def judged(cases) -> tuple[float, list[float]]:
    """(% missed, milliseconds of each)."""
    missed, taken_ms = [], []
    for felt, mesh, truth in cases:
        began_s = time.process_time()
        found = pose(felt, mesh, _PARAMS)
        taken_ms.append(1e3 * (time.process_time() - began_s))
        told = [] if found.sensor_from_object is None else [found.sensor_from_object, *found.alternatives]
        middle = found.scene_mm.mean(axis=0)
        missed.append(all(symmetric_error(p, truth, mesh, None, middle).mssd_mm > _FOUND_MM for p in told))
    return 100.0 * float(np.mean(missed)), taken_ms


def answer(part: str = "") -> Answer:
    cases = list(touches())
    judged(cases[:2])  # compiled, and grids at hand
    usual, usual_ms = judged(cases)
    rows = []
    for name in (n for n in COUNTS if part in n):
        value, beside = getattr(search, name), {}
        for other in (max(value // 2, 1), 2 * value):
            setattr(search, name, other)
            try:
                beside[other] = judged(cases) if other != value else (usual, usual_ms)
            finally:
                setattr(search, name, value)
        best = min(beside, key=lambda n: (beside[n][0], np.median(beside[n][1])))
        told = ", ".join(f"{n}: {missed:.1f} %, {np.median(ms):.0f} ms" for n, (missed, ms) in beside.items())
        bar = Bar(closer=1.0, faster=0.9 if beside[best][0] == usual else None)
        rows.append(row(
            f"search.{name} = {value}", peer=told, ours=timing(usual_ms), peer_timing=timing(beside[best][1]),
            ours_error=usual, peer_error=beside[best][0], unit="% missed", bar=bar,
        ))  # fmt: skip
    return Answer(title="Counts of the pose's search beside their half and double", unit="% missed", rows=tuple(rows),
                  notes=(f"{len(cases)} touches",))  # fmt: skip


if __name__ == "__main__":
    show(answer(*sys.argv[1:2]))
