"""Do simulated GelSlim-Soft Bubble pairs have the statistics that were published for the lab's real pairs?

Run: python benchmarks/paired_statistics.py [POSES]. Twelve training objects, POSES (10) single grasps each, with noise.
Published: standard deviation of (touch - reference) / 255 per channel of GelSlim pictures, and mean, standard
deviation, minimum and maximum of bubble imprints (reference - reading) in mm, over 12 tools x 1344 grasps.
Each figure is to lie within 25 % of the published one. Where the lab's own tool meshes are at hand (TACTILE_DATA, or
../shared/data beside the project) nine of them are pressed in the same way: what differs then is not the objects.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import numpy as np

from pipeline.physics import datasets
from pipeline.physics.datasets import Plan
from pipeline.physics.recorder import workers

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
    (gel, _), (bubble, _) = datasets.moment(plan, index).readings
    difference = (gel.image.astype(np.float32) - gel.reference) / 255
    return difference.reshape(-1, 3), np.asarray(bubble.reference - bubble.image, np.float64)


def statistics(plans, pool):
    """The published figures of all grasps of `plans`, and the mean imprint of each object."""
    jobs = [(plan.tool, pool.submit(summed, plan, k)) for plan in plans for k in range(plan.poses)]
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


def summed(plan, index):
    difference, imprint = changes(plan, index)
    seen = imprint[np.isfinite(imprint)]
    wide = difference.astype(np.float64)
    return (
        len(wide), wide.sum(0), (wide**2).sum(0),
        seen.size, seen.sum(), (seen**2).sum(), seen.min(), seen.max(),
    )  # fmt: skip


def table(title, figures, usual):
    print(title)
    print(f"{'figure':20s} {'published':>10s} {'simulated':>10s} {'ratio':>6s}  within {WITHIN:.0%}")
    for name, published in PUBLISHED.items():
        ratio = figures[name] / published
        verdict = "yes" if abs(ratio - 1) <= WITHIN else "no"
        print(f"{name:20s} {published:10.4g} {figures[name]:10.4g} {ratio:6.2f}  {verdict}")
    print(f"a usual grasp's imprint spans {usual[0]:.1f} to {usual[1]:.1f} mm")


def lab_tools():
    beside = Path(__file__).parents[2] / "shared" / "data"
    folder = Path(os.environ.get("TACTILE_DATA", beside)) / "tools"
    return tuple(str(path) for number in LAB_TOOLS for path in folder.glob(f"pattern_{number}*.stl"))


def main():
    n = int(sys.argv[1]) if len(sys.argv) > 1 else 10
    like = Plan(sensors=("gelslim", "soft_bubble"), tool="", poses=n, seed=0, mesh_unit="m", mesh_face="-x")
    plans = datasets.plans(("training",), like)
    lab = datasets.plans(lab_tools(), like) if lab_tools() else ()
    with workers(2) as pool:
        figures, each, usual = statistics(plans, pool)
        table(f"{len(plans)} training objects x {n} grasps", figures, usual)
        print("mean imprint by object:", ", ".join(f"{tool} {mean:.2f}" for tool, mean in each.items()))
        if lab:
            figures, _, usual = statistics(lab, pool)
            table(f"\n{len(lab)} of the lab's tools x {n} grasps", figures, usual)
        else:
            print("the lab's tool meshes are not at hand; only our own objects were pressed")


if __name__ == "__main__":
    main()
