"""Does a bad value cost time: NaN, infinite, denormal or enormous, in one place or in all?

python -m benchmarks.bad_values. Each stage, on a small touch, against the same stage on the clean one in turns; a row
is the value and the share of places that took longest. Peer of a poison that leaves holes: the same holes in NaN, since
scattered points are harder to lie on than a ball.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from benchmarks.harness.results import BenchmarkResult
from benchmarks.harness.text_report import print_result
from benchmarks.harness.timing import Requirement, build_measurement, time_in_turns
from pipeline.stages.cloud.back_projection import BackProjectionParams, back_project_depth
from pipeline.stages.depth.photometric import DepthParams, estimate_depth
from pipeline.stages.target_depth.surface_projection import SurfaceProjectionParams, project_cloud
from pipeline.stages.touch.physical_render import PhysicalRenderParams, render_touch
from tests.stability.checks import outcome
from tests.stability.scenes import aligned, depth_map, frame, indentation_mm, small, view
from tests.stability.test_poison import POISONS, poisoned

SHARES = ("some", "most", "all")
RUNS = 5
TIMES = 2.0  # of the clean case


def scenes():
    """Stage -> (function, its first input, what is poisoned in it, the other inputs)."""
    rng = np.random.default_rng(5)
    source, target, gel = small("gelslim"), small("soft_bubble", 0.5), small("digit")
    clean = depth_map(source, indentation_mm(source, "sphere", rng))
    points = back_project_depth(clean, aligned(source, target), BackProjectionParams())
    bubble_frame, bubble_view = frame("soft_bubble"), view(target, 0.3 * indentation_mm(target, "sphere", rng))
    gel_view = view(gel, 0.3 * indentation_mm(gel, "sphere", rng))
    return {
        "depth": (estimate_depth, bubble_frame, ("image",), (small("soft_bubble"), None, DepthParams())),
        "adapt": (back_project_depth, clean, ("depth_mm",), (aligned(source, target), BackProjectionParams())),
        "project": (project_cloud, points, ("points_mm",), (target, SurfaceProjectionParams())),
        "generate, gel": (render_touch, gel_view, ("depth_mm", "indentation_mm"), (gel, PhysicalRenderParams())),
        "generate, bubble": (
            render_touch,
            bubble_view,
            ("depth_mm", "indentation_mm"),
            (target, PhysicalRenderParams()),
        ),
    }


def slowest(stage, scene):
    """The row of the poison that costs this stage most beside its clean cases."""
    run, clean, fields, rest = scene
    worst = None
    for poison in sorted(POISONS):
        # An enormous indentation is cut at the sensor's limit: another press, and a deeper one.
        spoilt = ("depth_mm",) if poison in ("far", "huge") and stage.startswith("generate") else fields
        plain = "zero" if abs(POISONS[poison]) < 1e-20 else "nan"
        for share in SHARES:
            bad, usual = (
                replace(clean, **{f: poisoned(getattr(clean, f), p, share, np.random.default_rng(7)) for f in spoilt})
                for p in (poison, plain)
            )
            calls = {"bad": bad, "usual": usual, "clean": clean}
            times = time_in_turns(
                {name: lambda value=value: outcome(run, value, *rest) for name, value in calls.items()}, RUNS
            )
            peer = max((times["usual"], times["clean"]), key=lambda timing: timing.median_ms)
            if worst is None or times["bad"].median_ms / peer.median_ms > worst[0]:
                worst = times["bad"].median_ms / peer.median_ms, poison, share, times["bad"], peer
    _, poison, share, ours, peer = worst
    return build_measurement(
        f"{stage}, bad values", ours=ours, ours_error=math.nan, unit="", peer="the clean case", peer_timing=peer,
        bar=Requirement(min_speedup=1 / TIMES),
    ), f"{stage}: worst with {poison} in {share} places"  # fmt: skip


def measure() -> BenchmarkResult:
    rows, notes = zip(*(slowest(stage, scene) for stage, scene in scenes().items()), strict=True)
    return BenchmarkResult(title="Bad values beside the clean case", unit="", rows=rows, notes=notes)


if __name__ == "__main__":
    print_result(measure())
