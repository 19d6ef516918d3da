"""What every test may ask for."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings

# A landing must not hang on the luck of the draw: where CI runs, every run tries the same examples;
# elsewhere new ones. No deadline for one example: a kernel compiles within it, and other programs
# use the machine.
settings.register_profile("tests", deadline=None, derandomize=bool(os.environ.get("CI")))
settings.load_profile("tests")

_BESIDE = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture(scope="session")
def real_data() -> Path:
    """The folder of real recordings; the test is skipped where there is none."""
    folder = Path(os.environ.get("TACTILE_DATA", _BESIDE))
    if not folder.is_dir():
        pytest.skip(f"no real recordings at {folder.name!r} (set TACTILE_DATA)")
    return folder


@pytest.fixture(scope="module")
def shared_results() -> Iterator[None]:
    """Frames that tests of several modules evaluate are computed once in this process."""
    from tests.shared_results import share_results

    with pytest.MonkeyPatch.context() as patch:
        share_results(patch)
        yield


@pytest.fixture(scope="session")
def rollout_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One grasp of the hex key, inserted by its planned pose and by T2T at two clearances: four
    rollouts.
    """
    from pipeline.lab.tasks.runner import make_jobs, run_job

    folder = tmp_path_factory.mktemp("rollouts")
    jobs = make_jobs(
        "insertion",
        cases=("hex_key",),
        touches=("none", "t2t"),
        tolerances_mm=(0.1, 2.0),
        n_trials=4,
        folder=folder,
    )
    run_job(jobs[3])
    return folder
