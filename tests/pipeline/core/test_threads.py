"""The limit of threads of the process holds whatever is loaded first."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
_PRINT = """
import hashlib, threadpoolctl
values = numpy.random.default_rng(0).normal(size=(700, 300))
sums = numpy.linalg.solve(values.T @ values, values.T @ values[:, 0]), scipy.linalg.solve(values.T @ values, values[0])
print([pool["num_threads"] for pool in threadpoolctl.threadpool_info() if pool["user_api"] == "blas"])
print(hashlib.sha256(b"".join(one.tobytes() for one in sums)).hexdigest())
"""


def run(code: str) -> list[str]:
    wanted = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "2")
    done = subprocess.run(
        [sys.executable, "-c", code + _PRINT],
        env={**os.environ, **wanted},
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.splitlines()


def test_linear_algebra_has_one_thread_and_the_same_bytes_whatever_is_loaded_first():
    ours, theirs, between = (
        run(f"import {order}\n")
        for order in (
            "pipeline, numpy, scipy.linalg",
            "numpy, scipy.linalg, pipeline",
            "numpy, pipeline, scipy.linalg",
        )
    )
    assert ours[0] == "[1, 1]"
    assert ours == theirs == between


@pytest.mark.parametrize("first", ["numpy", "pipeline.stages.depth.photometric"])
def test_a_worker_has_the_limit_of_its_parent(first):
    code = (
        f"import {first}\nimport pipeline.core.processes, numpy, "
        "scipy.linalg\npipeline.core.processes.limit_threads()\n"
    )
    assert set(json.loads(run(code)[0])) == {1}
