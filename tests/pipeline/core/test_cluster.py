"""Work on other machines, tried on a cluster of two processes of which one is killed midway."""

from __future__ import annotations

import json
import os
import shutil
import signal
import socket
import sys
import threading
import time
import warnings
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from pipeline.cli.main import EXIT_USER_ERROR, build_app, run_app
from pipeline.core.cluster import NO_WORKER_S, connect_cluster
from pipeline.core.errors import NotConverged, SettingProblem
from pipeline.io import hdf5
from pipeline.lab.tasks.runner import make_jobs, run_job, run_jobs
from pipeline.physics.simulation import shapes

distributed = pytest.importorskip("distributed", reason="Dask is not installed")
ONE = shapes.list_shapes("training")[0]
UNTOUCHED = Path(__file__).parents[3] / "sample_data" / "recordings" / "no_contact.h5"


@pytest.fixture(scope="module")
def cluster():
    """Two workers, each a process of its own."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        made = distributed.LocalCluster(
            n_workers=2,
            threads_per_worker=1,
            processes=True,
            dashboard_address=None,
            host="127.0.0.1",
            env={"PYTHONPATH": os.pathsep.join(p for p in sys.path if p), "OMP_NUM_THREADS": "1"},
        )
        yield made
        made.close()


def noted(piece):
    """The square of a number, written to a file each time that it is computed."""
    number, folder = piece
    time.sleep(0.3)
    with Path(folder, f"{number}_{os.getpid()}_{time.monotonic_ns()}").open("x"):
        pass
    return number * number


def pids(cluster):
    return [worker.pid for worker in cluster.workers.values()]


@pytest.mark.filterwarnings("ignore")
def test_a_killed_worker_loses_nothing_and_what_is_here_is_not_done_again(cluster, tmp_path):
    class KillsOne:
        """Kills a worker once a quarter is done."""

        killed = False

        def step(self, fraction, text):
            if fraction >= 0.25 and not self.killed:
                self.killed = True
                self.here = round(12 * fraction)
                os.kill(pids(cluster)[0], signal.SIGKILL)
                self.done = len(list(tmp_path.iterdir()))

    watching = KillsOne()
    with connect_cluster(cluster.scheduler_address) as elsewhere:
        found = elsewhere.map(noted, [(n, str(tmp_path)) for n in range(12)], watching)
    assert watching.killed
    assert found == [n * n for n in range(12)]
    done = [name.name.split("_")[0] for name in tmp_path.iterdir()]
    assert set(done) == {str(n) for n in range(12)}
    # Done again is at most what the killed worker had finished, or was about to, and had not handed
    # over.
    assert len(done) - 12 <= watching.done - watching.here + 1


@pytest.mark.filterwarnings("ignore")
def test_work_without_any_worker_ends_with_a_sentence(monkeypatch, tmp_path):
    monkeypatch.setattr("pipeline.core.cluster.NO_WORKER_S", 1.5)
    steps = []
    counting = SimpleNamespace(step=lambda fraction, text: steps.append(text))
    with (
        distributed.LocalCluster(n_workers=0, dashboard_address=None, host="127.0.0.1") as empty,
        connect_cluster(empty.scheduler_address) as elsewhere,
        pytest.raises(NotConverged, match=r"no worker .* 0 of 2 done"),
    ):
        elsewhere.map(noted, [(1, str(tmp_path)), (2, str(tmp_path))], counting)
    assert steps  # Ctrl-C is noticed meanwhile


@pytest.mark.slow  # processes that start, and wait
@pytest.mark.filterwarnings("ignore")
def test_work_whose_workers_all_leave_ends_with_a_sentence(monkeypatch, tmp_path):
    assert NO_WORKER_S < 25.0
    monkeypatch.setattr("pipeline.core.cluster.NO_WORKER_S", 1.5)
    with distributed.LocalCluster(
        n_workers=1, processes=False, dashboard_address=None, protocol="tcp://", host="127.0.0.1"
    ) as leaving:

        class Dismisses:
            """Dismisses the only worker once one piece is done."""

            def step(self, fraction, text):
                if fraction > 0.0 and leaving.workers:
                    leaving.scale(0)

        with (
            connect_cluster(leaving.scheduler_address) as elsewhere,
            pytest.raises(NotConverged, match="no worker"),
        ):
            elsewhere.map(noted, [(n, str(tmp_path)) for n in range(40)], Dismisses())
    assert 0 < len(list(tmp_path.iterdir())) < 40


@pytest.mark.slow  # processes that start, and wait
@pytest.mark.filterwarnings("ignore")
def test_trials_of_a_task_run_elsewhere_are_those_run_here_though_a_worker_dies(cluster):
    jobs = make_jobs("marble", touches=("expert", "none"), n_trials=6)

    class KillsOne:
        """Kills a worker once a trial is done."""

        killed = False

        def step(self, fraction, text):
            if fraction > 0.0 and not self.killed:
                self.killed = True
                os.kill(pids(cluster)[0], signal.SIGKILL)

    killer = KillsOne()
    with connect_cluster(cluster.scheduler_address) as elsewhere:
        there = run_jobs(jobs, 1, elsewhere, killer)
    assert killer.killed
    assert json.dumps(there) == json.dumps([one for job in jobs for one in run_job(job)])


@pytest.mark.filterwarnings("ignore")
def test_a_recording_made_elsewhere_has_the_same_bytes(cluster, tmp_path):
    paths = tmp_path / "here.h5", tmp_path / "there.h5"
    common = ["simulate", "--sensors", "digit", "--tools", ONE, "--poses", "3", "--jobs", "1"]
    assert run_app(build_app(), [*common, "--out", str(paths[0])]) == 0
    assert (
        run_app(
            build_app(), [*common, "--out", str(paths[1]), "--scheduler", cluster.scheduler_address]
        )
        == 0
    )
    here, there = (hdf5.read(path) for path in paths)
    for index in range(3):
        a, b = (file.stream("digit").frame(index) for file in (here, there))
        assert a.image.tobytes() == b.image.tobytes()
    assert paths[0].read_bytes() == paths[1].read_bytes()


@pytest.mark.slow  # each process loads and draws for the first time: 20 s of processor time
@pytest.mark.timeout(600)
@pytest.mark.filterwarnings("ignore")
def test_frames_translated_elsewhere_are_those_translated_here_though_a_worker_dies(
    cluster, tmp_path, monkeypatch
):
    """One of two workers is killed once a frame is there: none is lost, what was done is not
    done again.
    """
    monkeypatch.chdir(tmp_path)  # workers have another folder
    shutil.copy(UNTOUCHED, "still.h5")
    frames = "frame_0000", "frame_0001", "frame_0002"
    common = ["translate", "still.h5", "--target", "digit", "--sensor", "gelslim", "--all"]
    written = {}

    def kill_one():
        while not (done := list(Path("there").glob("frame_*/frame.json"))):
            time.sleep(0.02)
        written.update({path: path.stat().st_mtime_ns for path in done})
        os.kill(pids(cluster)[0], signal.SIGKILL)

    killer = threading.Thread(target=kill_one, daemon=True)
    killer.start()
    assert (
        run_app(build_app(), [*common, "--out", "there", "--scheduler", cluster.scheduler_address])
        == 0
    )
    assert not killer.is_alive()
    assert {path: path.stat().st_mtime_ns for path in written} == written
    assert run_app(build_app(), [*common, "--out", "here"]) == 0
    for name in frames:
        here, there = (np.load(Path(where, name, "stages.npz")) for where in ("here", "there"))
        assert here.files == there.files
        assert all(here[key].tobytes() == there[key].tobytes() for key in here.files)


def test_single_frames_stay_here(capsys):
    common = [
        "translate",
        str(UNTOUCHED),
        "--target",
        "digit",
        "--out",
        "x",
        "--scheduler",
        "tcp://127.0.0.1:1",
    ]
    assert run_app(build_app(), common) == EXIT_USER_ERROR
    assert "--scheduler distributes frames" in capsys.readouterr().err


def test_an_address_without_a_scheduler_is_one_sentence(capsys, monkeypatch):
    monkeypatch.setattr("pipeline.core.cluster.CONNECT_S", 0.3)
    with (
        pytest.raises(SettingProblem, match="no scheduler answers"),
        connect_cluster("tcp://127.0.0.1:1"),
    ):
        pass
    tokens = [
        "simulate",
        "--sensors",
        "digit",
        "--tools",
        ONE,
        "--poses",
        "1",
        "--out",
        "x.h5",
        "--scheduler",
        "nonsense://",
    ]
    assert run_app(build_app(), tokens) == EXIT_USER_ERROR
    assert "no scheduler answers" in capsys.readouterr().err


@pytest.mark.parametrize(
    "address",
    [
        "tls://127.0.0.1:1",
        "ucx://127.0.0.1:1",
        "zz://",
        "inproc://x",
        "tcp://127.0.0.1",
        "tcp://127.0.0.1:99999",
        "",
        "tcp://[:1",
        "127.0.0.1:1",
        "tcp://\udcff:1",
    ],
)
def test_an_address_of_no_scheduler_is_one_sentence(address, capfd):
    with pytest.raises(SettingProblem, match="scheduler"), connect_cluster(address):
        pass
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(
    "greeting", [None, b"", b"HTTP/1.1 200 OK\r\n\r\n", b"\xff" * 64, bytes(64)]
)
def test_a_server_that_is_no_scheduler_is_one_sentence(greeting, monkeypatch, capfd):
    """It says nothing, closes the connection, or speaks another language."""
    monkeypatch.setattr("pipeline.core.cluster.CONNECT_S", 0.5)

    def answer() -> None:
        connection = server.accept()[0]
        with connection:
            if greeting is None:
                done.wait(60.0)
            else:
                connection.sendall(greeting)

    done = threading.Event()
    with socket.create_server(("127.0.0.1", 0)) as server:
        thread = threading.Thread(target=answer)
        thread.start()
        address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        with pytest.raises(SettingProblem, match="no scheduler answers"), connect_cluster(address):
            pass
        done.set()
        thread.join()
    assert capfd.readouterr().err == ""
