"""How many poses are found from bad first guesses? Ours from one start and from many, beside Open3D from the same.

    python benchmarks/pose_basin.py

The tool and the contacts of the question "pose". First guesses are off by an angle of 20 degrees (standard deviation)
about a random axis and by 2.5 mm (standard deviation) along each axis. Found means within 0.1 mm and 0.5 degrees.
Errors are the shares, in percent, that were not found.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks import pose
from pipeline.racing.races import Answer, Bar, Point, Timing, race, row
from pipeline.racing.report import show
from pipeline.registration.gauss_newton import How
from pipeline.registration.multistart import Found, Many, around, register_many

TRIALS, _TURN_DEG, _SHIFT_MM = 200, 20.0, 2.5
_FIRST_SEED = 50_000  # none of these contacts was looked at while anything here was chosen
_FOUND_MM, _FOUND_DEG = 0.1, 0.5
_N_STARTS, _SPREAD = 24, 2.0  # starts, over a ball of so many standard deviations


def from_many(of: pose.Tool, points: np.ndarray, start: np.ndarray) -> np.ndarray:
    """The best of 24 starts around the first guess."""
    starts = around(start, points.mean(axis=0), _N_STARTS, _SPREAD * _TURN_DEG, _SPREAD * _SHIFT_MM)
    found = register_many(points, of.grid, starts, How(max_distance_mm=pose.REACH_MM), Many(n_polished=2))
    return found.fits[0].sensor_from_object if isinstance(found, Found) else start


def answer() -> Answer:
    it = pose.tool()
    trials = [
        pose.trial(it, seed, _TURN_DEG, _SHIFT_MM, spread=True) for seed in range(_FIRST_SEED, _FIRST_SEED + TRIALS)
    ]
    open3d = pose.open3d_icp(it)
    calls = {
        "ours, one start": lambda t: pose.ours(it, t.points, t.start),
        "ours, 24 starts": lambda t: from_many(it, t.points, t.start),
        "Open3D point-to-plane, one start": lambda t: open3d(t.points, t.start),
    }
    missed = {name: 100.0 * float(np.mean([not _found(call(t), t) for t in trials])) for name, call in calls.items()}
    times = _timed(calls, trials)
    one, many, peer = calls
    return Answer(
        title="Poses found from 20 degrees and 2.5 mm off", unit="% missed",
        rows=(
            row("basin, one start", ours=times[one], ours_error=missed[one], unit="% missed", peer=peer,
                peer_timing=times[peer], peer_error=missed[peer], bar=Bar(closer=1.0)),
            row("basin, 24 starts", ours=times[many], ours_error=missed[many], unit="% missed", peer=peer,
                peer_timing=times[peer], peer_error=missed[peer], bar=Bar(ms=30.0, error=5.0)),
        ),
        points=tuple(Point(method=n, ms=times[n].median_ms, error=missed[n], ours=n.startswith("ours")) for n in calls),
        notes=(f"{TRIALS} contacts", *(f"{n}: found {100 - missed[n]:.1f} %" for n in calls)),
    )  # fmt: skip


def _found(pose_: np.ndarray, of: pose.Trial) -> bool:
    mm, deg = pose.error(pose_, of)
    return mm < _FOUND_MM and deg < _FOUND_DEG


def _timed(calls, trials: list[pose.Trial]) -> dict[str, Timing]:
    raced = [race({n: (lambda c=c, t=t: c(t)) for n, c in calls.items()}, runs=3) for t in trials[:16]]
    return {
        n: Timing(median_ms=float(np.median([r[n].median_ms for r in raced])), p95_ms=max(r[n].p95_ms for r in raced))
        for n in calls
    }


if __name__ == "__main__":
    show(answer())
