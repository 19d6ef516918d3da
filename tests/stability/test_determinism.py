"""The same input and seed give the same bytes: again, in another process, and on another number
of threads.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.core.digests import compute_digest
from pipeline.stages.cloud.back_projection import BackProjectionParams, back_project_depth
from pipeline.stages.depth.photometric import DepthParams, estimate_depth
from pipeline.stages.pose.signed_distances import PoseParams, estimate_pose
from pipeline.stages.target_depth.surface_projection import SurfaceProjectionParams, project_cloud
from pipeline.stages.touch.physical_render import PhysicalRenderParams, render_touch
from tests.stability.rows import row
from tests.stability.scenes import aligned, frame, mesh, small

ROOT = Path(__file__).resolve().parents[2]


def chain(name: str, target: str, seed: int, *, posed: bool = False) -> dict[str, str]:
    """Stage -> digest of what it gives for one simulated frame."""
    source = small(name)
    other = small(target)
    d = estimate_depth(frame(name, seed), source, None, DepthParams())
    c = back_project_depth(d, aligned(source, other), BackProjectionParams())
    v = project_cloud(c, other, SurfaceProjectionParams())
    t = render_touch(v, other, PhysicalRenderParams(add_noise=True, seed=seed))
    found = {"depth": d, "adapt": c, "project": v, "generate": t}
    if posed:
        found["pose"] = estimate_pose(t.membrane, mesh("ball"), PoseParams(face="+z", n_starts=6))
    return {stage: compute_digest(result) for stage, result in found.items()}


@row(15, "the chain twice: the same bytes of every stage", share=0.02)
@given(
    st.sampled_from([("digit", "soft_bubble"), ("gelslim", "digit"), ("soft_bubble", "gelslim")]),
    st.integers(0, 20),
)
def test_again(pair, seed):
    assert chain(*pair, seed) == chain(*pair, seed)


def in_a_process(threads: int, *asked: str) -> str:
    names = ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    done = subprocess.run(
        [sys.executable, "-m", "tests.stability.test_determinism", *asked],
        capture_output=True,
        text=True,
        check=True,
        cwd=ROOT,
        env={**os.environ, **dict.fromkeys(names, str(threads))},
    )
    return done.stdout.strip()


@pytest.mark.parametrize("pair", [("gelslim", "soft_bubble"), ("soft_bubble", "digit")])
@row(15, "the chain in another process, on one thread and on two: the same bytes of every stage")
def test_on_another_number_of_threads(pair):
    """The gel's look-up is fitted on the spot, so that its linear algebra is part of it."""
    one, two = (in_a_process(n, *pair) for n in (1, 2))
    assert one
    assert one == two


if __name__ == "__main__":
    sys.stdout.write(f"{chain(*sys.argv[1:3], 3)}\n")
