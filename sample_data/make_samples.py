"""Simulate the sample recordings: `python -m sample_data.make_samples [NAME ...]`.

All files in `sample_data/recordings` come from here; the same code gives the same images.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

from pipeline.lab.recorder import record_plan
from pipeline.physics.simulation.datasets import SimulationPlan
from sample_data import first_touch, hard_cases

RECORDINGS_FOLDER = Path(__file__).parent / "recordings"
LIMIT_MB = 20.0  # of all samples together


def write_sample(plan: SimulationPlan, path: Path) -> None:
    """Write a recording as `tactoscope simulate` does, from the start."""
    path.unlink(missing_ok=True)
    record_plan(plan, path)


MAKERS: dict[str, Callable[[Path], None]] = {
    "first_touch": first_touch.make_recording,
    "grasps_lines_120": partial(
        write_sample,
        SimulationPlan(
            sensors=("gelslim", "soft_bubble"), object_source="lines_120", n_poses=3, seed=7
        ),
    ),
    "grasps_curve": partial(
        write_sample,
        SimulationPlan(
            sensors=("gelslim", "soft_bubble"), object_source="curve", n_poses=3, seed=8
        ),
    ),
    "grasps_cross": partial(
        write_sample,
        SimulationPlan(
            sensors=("gelslim", "soft_bubble"), object_source="cross", n_poses=3, seed=9
        ),
    ),
    "digit_gelslim": partial(
        write_sample,
        SimulationPlan(
            sensors=("digit", "gelslim"), object_source="wave", n_poses=6, seed=3, sequence="all"
        ),
    ),
    "no_contact": hard_cases.make_no_contact,
    "trouble": hard_cases.make_trouble,
}


def main() -> None:
    """Write the named sample recordings, or all, and print their sizes."""
    RECORDINGS_FOLDER.mkdir(parents=True, exist_ok=True)
    for name in sys.argv[1:] or MAKERS:
        path = RECORDINGS_FOLDER / f"{name}.h5"
        MAKERS[name](path)
        print(f"{path.name}: {path.stat().st_size / 1e6:.2f} MB")  # noqa: T201 - output of a script
    total_mb = sum(path.stat().st_size for path in RECORDINGS_FOLDER.glob("*.h5")) / 1e6
    assert total_mb < LIMIT_MB, f"the samples take {total_mb:.1f} MB, more than {LIMIT_MB:g} MB"


if __name__ == "__main__":
    main()
