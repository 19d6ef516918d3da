"""The machine that a measurement is made with."""

import os
import subprocess
import sys

SCRIPT = """
import threadpoolctl
from pipeline.base.machine import limit_blas_to_one_thread

with limit_blas_to_one_thread():
    pass
import scipy.linalg
with limit_blas_to_one_thread():
    print([pool["num_threads"] for pool in threadpoolctl.threadpool_info() if pool["user_api"] == "blas"])
"""


def test_a_blas_that_is_loaded_after_the_first_use_is_limited_as_well():
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "2", "OMP_NUM_THREADS": "2"}
    said = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True, env=environment)
    assert set(said.stdout.strip(" []\n").split(", ")) == {"1"}
