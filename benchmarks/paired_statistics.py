"""Do simulated GelSlim-Soft Bubble pairs have the statistics that were published for the lab's real pairs?

Run: python benchmarks/paired_statistics.py [POSES]. Twelve training objects, POSES (10) single grasps each, with noise.
Published: standard deviation of (touch - reference) / 255 per channel of GelSlim pictures, and mean, standard
deviation, minimum and maximum of bubble imprints (reference - reading) in mm, over 12 tools x 1344 grasps.
Each figure is to lie within 25 % of the published one. Where the lab's own tool meshes are at hand (TACTILE_DATA, or
../shared/data beside the project) nine of them are pressed in the same way: what differs then is not the objects.
Minimum and maximum are those of one pixel among all of 16,128 grasps, so that they tell of the hardest grasp and of the
worst pixel, not of usual ones.
"""

from __future__ import annotations

import math
import os
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.timing import Requirement
from pipeline.racing.results import BenchmarkResult, Measurement
from pipeline.racing.text_report import print_result
from pipeline.simulation import datasets
from pipeline.simulation.datasets import SimulationPlan
from pipeline.simulation.recorder import make_worker_pool

WITHIN = 0.25
LAB_TOOLS = ("01", "02", "03", "04", "06", "31", "32", "33", "37")  # those of the published training pairs
PUBLISHED = {
    "GelSlim std red": 0.0989,
    "GelSlim std green": 0.0746,
    "GelSlim std blue": 0.0731,
    "bubble mean mm": 3.82,
    "bubble std mm": 4.24,
    "bubble minimum mm": -11.6,
    "bubble maximum mm": 22.5,
}


def changes(plan, index):
    """(GelSlim difference (n, 3) of full scale, bubble imprint in mm) of one grasp."""
    (gel, _), (bubble, _) = datasets.simulate_moment(plan, index).frames
    difference = (gel.image.astype(np.float32) - gel.reference) / 255
    return difference.reshape(-1, 3), np.asarray(bubble.reference - bubble.image, np.float64)


def statistics(plans, pool):
    """The published figures of all grasps of `plans`, and the mean imprint of each object."""
    jobs = [(plan.tool, pool.submit(sum_changes, plan, k)) for plan in plans for k in range(plan.poses)]
    sums = {}
    for tool, job in jobs:
        sums.setdefault(tool, []).append(job.result())
    n, one, two, m, imprint, imprint_sq, low, high = (
        np.array([s[k] for rows in sums.values() for s in rows]) for k in range(8)
    )
    gel_mean = one.sum(0) / n.sum()
    gel_std = np.sqrt(two.sum(0) / n.sum() - gel_mean**2)
    mean = imprint.sum() / m.sum()
    std = np.sqrt(imprint_sq.sum() / m.sum() - mean**2)
    figures = dict(zip(PUBLISHED, (*gel_std, mean, std, low.min(), high.max()), strict=True))
    each = {tool: np.mean([s[4] / s[3] for s in rows]) for tool, rows in sums.items()}
    return figures, each, (np.median(low), np.median(high))


def sum_changes(plan, index):
    difference, imprint = changes(plan, index)
    seen = imprint[np.isfinite(imprint)]
    wide = difference.astype(np.float64)
    return (
        len(wide), wide.sum(0), (wide**2).sum(0),
        seen.size, seen.sum(), (seen**2).sum(), seen.min(), seen.max(),
    )  # fmt: skip


def lab_tools():
    beside = Path(__file__).parents[2] / "shared" / "data"
    folder = Path(os.environ.get("TACTILE_DATA", beside)) / "tools"
    return tuple(str(path) for number in LAB_TOOLS for path in folder.glob(f"pattern_{number}*.stl"))


def compare_published(objects, figures, seconds):
    """One row a figure: the error is how far simulated over published is from 1."""
    bar = Requirement(max_error=WITHIN)
    for name, published in PUBLISHED.items():
        off = abs(figures[name] / published - 1)
        yield Measurement(
            question=f"{name}, {objects}, for {published:.4g}", peer="", ours_ms=seconds * 1e3,
            peer_ms=math.nan, ratio=math.nan, ours_error=off, peer_error=math.nan, unit="of it", bar=bar.describe("of it"),
            holds=bar.is_met((math.nan, off), (math.nan, math.nan)),
        )  # fmt: skip


def measure(n: int = 10) -> BenchmarkResult:
    like = SimulationPlan(
        sensors=("gelslim", "soft_bubble"), object_source="", n_poses=n, seed=0, mesh_unit="m", mesh_face="-x"
    )
    sets = {"training objects": datasets.make_plans(("training",), like)}
    notes = []
    if lab_tools():
        sets["the lab's tools"] = datasets.make_plans(lab_tools(), like)
    else:
        notes.append("the lab's tool meshes are not at hand; only our own objects were pressed")
    rows = []
    with make_worker_pool(2) as pool:
        for objects, plans in sets.items():
            started = time.perf_counter()
            figures, each, (low, high) = statistics(plans, pool)
            rows += compare_published(objects, figures, (time.perf_counter() - started) / (n * len(plans)))
            notes.append(f"{len(plans)} {objects} x {n} grasps; a usual one spans {low:.1f} to {high:.1f} mm")
            means = ", ".join(f"{Path(tool).stem} {mean:.2f}" for tool, mean in each.items())
            notes.append(f"mean imprint in mm: {means}")
            notes.append(f"{objects}: " + ", ".join(f"{name} {figure:.4g}" for name, figure in figures.items()))
    return BenchmarkResult(
        title="Simulated pairs beside published ones", unit="of it", rows=tuple(rows), notes=tuple(notes)
    )


if __name__ == "__main__":
    print_result(measure(*(int(word) for word in sys.argv[1:2])))
