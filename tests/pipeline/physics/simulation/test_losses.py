"""Simulated recordings after a full disk and after a kill hold the finished moments and no
partial ones.
"""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from pipeline.io import hdf5
from pipeline.lab import recorder
from pipeline.physics.simulation import shapes
from pipeline.physics.simulation.datasets import SimulationPlan
from pipeline.sensors.spec import load_sensor

TOOL = shapes.list_shapes("training")[0]
POSES = 6
PLAN = SimulationPlan(sensors=("digit",), object_source=TOOL, n_poses=POSES, seed=0)
LONG_S = 120  # only a process that hangs takes so long

SIMULATE = """
import resource, sys
from pipeline.cli.main import build_app, run_app
from pipeline.lab import recorder
limit, recorder.PUBLISH_INTERVAL_S = int(sys.argv[1]), 0.0
if limit:
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))
sys.exit(run_app(build_app(), ["simulate", *sys.argv[2:]]))
"""
KILLED = """
import os, signal, sys
from pathlib import Path
from pipeline.core.files import open_atomic
with open_atomic(Path(sys.argv[1]), "the recording", None) as file:
    file.write(b"half a recording")
    file.flush()
    os.kill(os.getpid(), signal.SIGKILL)
"""
WORKER = """
import os, sys
from pipeline.lab.recorder import make_worker_pool
if __name__ == "__main__":
    pool = make_worker_pool(1)
    pool.submit(os.getpid).result()
    print("working", flush=True)
    sys.stdin.read()
"""


def simulated(out: Path, limit: int) -> subprocess.CompletedProcess[str]:
    """`tactoscope simulate` in a process whose files may not grow beyond `limit` bytes, as on a
    full disk.
    """
    options = [
        "--sensors",
        "digit",
        "--tools",
        TOOL,
        "--poses",
        str(POSES),
        "--jobs",
        "1",
        "--out",
        str(out),
    ]
    return subprocess.run(
        [sys.executable, "-c", SIMULATE, str(limit), *options],
        capture_output=True,
        text=True,
        timeout=LONG_S,
        check=False,
    )


def readable(path: Path) -> int:
    recording = hdf5.read(path)
    try:
        stream = recording.streams[0]
        assert all(
            stream.frame(k).image.any() and stream.truth(k) is not None
            for k in range(stream.n_frames)
        )
        return stream.n_frames
    finally:
        recording.close()


@pytest.mark.skipif(sys.platform != "linux", reason="limits the size of files as Linux does")
def test_a_full_disk_is_an_error_and_the_next_run_continues(tmp_path):
    assert simulated(tmp_path / "whole.h5", 0).returncode == 0
    whole = (tmp_path / "whole.h5").stat().st_size
    out = tmp_path / "full.h5"
    rows, cols = load_sensor("digit").camera.shape
    # and what is allocated ahead of a frame
    room = 2 * whole // 3 + 4 * 3 * rows * cols + (2 << 20)
    done = simulated(out, room)
    assert done.returncode == 2, done
    assert done.stderr.count("tactoscope: cannot write the recording (File too large)") == 1
    assert "Traceback" not in done.stderr
    assert [p.name for p in tmp_path.iterdir() if p.suffix != ".h5"] == []
    assert 0 < readable(out) < POSES
    assert simulated(out, 0).returncode == 0
    assert readable(out) == POSES


def test_workers_end_when_their_parent_is_killed(tmp_path):
    script = tmp_path / "parent.py"
    script.write_text(WORKER)
    parent = subprocess.Popen(
        [sys.executable, script], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert parent.stdout.readline() == "working\n"
    parent.kill()
    # the end of its output: the worker, which has it too, is gone
    parent.communicate(timeout=LONG_S)


def test_a_kill_costs_no_more_than_a_minute(tmp_path, monkeypatch):
    """Every moment takes twenty seconds: those that are older than a minute are in their place."""
    path = tmp_path / "a.h5"
    begun_s = []
    now_s = [0.0]
    monkeypatch.setattr(recorder, "time", SimpleNamespace(monotonic=lambda: now_s[0]))

    class Looks:
        def step(self, fraction, text):
            now_s[0] += 20.0
            begun_s.append(now_s[0])
            assert recorder.count_finished_moments(PLAN, path) >= sum(
                done_s < now_s[0] - 60.0 for done_s in begun_s
            )

    recorder.record_plan(PLAN, path, progress=Looks())
    assert len(begun_s) >= POSES


def test_files_of_a_killed_process_are_removed_by_the_next(tmp_path):
    killed = subprocess.run(
        [sys.executable, "-c", KILLED, tmp_path / "a.h5"], check=False, timeout=LONG_S
    )
    assert killed.returncode == -9
    assert [p.suffix for p in tmp_path.iterdir()] == [".part"]
    recorder.record_plan(replace(PLAN, n_poses=1), tmp_path / "a.h5")
    assert [p.name for p in tmp_path.iterdir()] == ["a.h5"]
