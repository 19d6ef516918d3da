"""The same input and seed give the same bytes: again, in another process, and on another number of threads."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.calibration import built_in, load, save, slopes
from pipeline.digests import digest
from pipeline.stages.adapt import AdaptParams, adapt
from pipeline.stages.depth import DepthParams, depth
from pipeline.stages.generate import GenerateParams, generate
from pipeline.stages.pose import PoseParams, pose
from pipeline.stages.project import ProjectParams, project
from tests.stability.rows import row
from tests.stability.scenes import aligned, frame, mesh, small

ROOT = Path(__file__).resolve().parents[2]
SLOPE = 1e-4  # mm/mm: a thousandth of what one grey level stands for


def chain(name: str, target: str, seed: int, *, posed: bool = False, look_up: Path | None = None) -> dict[str, str]:
    """Stage -> digest of what it gives for one simulated frame."""
    source, other = small(name), small(target)
    d = depth(frame(name, seed), source, None if look_up is None else load(look_up), DepthParams())
    c = adapt(d, aligned(source, other), AdaptParams())
    v = project(c, other, ProjectParams())
    t = generate(v, other, GenerateParams(noise=True, seed=seed))
    found = {"depth": d, "adapt": c, "project": v, "generate": t}
    if posed:
        found["pose"] = pose(t, mesh("ball"), PoseParams(face="+z", n_starts=6))
    return {stage: digest(result) for stage, result in found.items()}


@row(15, "the chain twice: the same bytes of every stage", share=0.02)
@given(
    st.sampled_from([("digit", "soft_bubble"), ("gelslim", "digit"), ("soft_bubble", "gelslim")]), st.integers(0, 20)
)
def test_again(pair, seed):
    assert chain(*pair, seed) == chain(*pair, seed)


@pytest.mark.xfail(strict=False, reason="the sums of Open3D's registration come in any order")
@row(15, "a pose twice: the same bytes", share=0.001)
@given(st.integers(0, 20))
def test_pose_again(seed):
    assert chain("gelslim", "digit", seed, posed=True) == chain("gelslim", "digit", seed, posed=True)


def in_a_process(threads: int, *asked: str) -> str:
    names = ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    told = subprocess.run(
        [sys.executable, "-m", "tests.stability.test_determinism", *asked],
        capture_output=True,
        text=True,
        check=True,
        cwd=ROOT,
        env={**os.environ, **dict.fromkeys(names, str(threads))},
    )
    return told.stdout.strip()


@pytest.mark.parametrize("pair", [("gelslim", "soft_bubble"), ("soft_bubble", "digit")])
@row(15, "the chain in another process, on one thread and on two: the same bytes of every stage")
def test_on_another_number_of_threads(pair, tmp_path):
    """With the same look-up: the one that is fitted on the spot is the next row's."""
    asked = list(pair)
    if pair[0] == "gelslim":
        save(built_in(small(pair[0])), tmp_path / "look_up.npz")
        asked.append(str(tmp_path / "look_up.npz"))
    one, two = (in_a_process(n, *asked) for n in (1, 2))
    assert one
    assert one == two


@row(15, "a look-up fitted on one thread and on two: slopes within a ten-thousandth")
def test_a_look_up_on_another_number_of_threads():
    """Sums of the linear algebra library are split by threads, so that the fit's last bits differ."""
    one, two = (np.array(json.loads(in_a_process(n, "look-up"))) for n in (1, 2))
    assert one.size > 100
    assert np.abs(one - two).max() <= SLOPE


def slopes_of_a_fresh_look_up() -> list[float]:
    seen = frame("gelslim", 3)
    gx, gy = slopes(built_in(small("gelslim")), seen.image, seen.reference)
    return [*gx.ravel().tolist(), *gy.ravel().tolist()]


if __name__ == "__main__":
    if sys.argv[1] == "look-up":
        print(json.dumps(slopes_of_a_fresh_look_up()))  # noqa: T201
    else:
        print(chain(*sys.argv[1:3], 3, look_up=Path(sys.argv[3]) if len(sys.argv) > 3 else None))  # noqa: T201
