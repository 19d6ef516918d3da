"""Worker processes: what leaves their pool."""

from __future__ import annotations

import multiprocessing
import os
import signal
import time

import pytest

from pipeline.base.processes import WorkerPool


def test_a_request_to_stop_ends_workers_that_are_busy():
    begin_s, running = time.monotonic(), []

    def work_until_stopped() -> None:
        with WorkerPool(1) as pool:
            pool.submit(os.getpid).result()
            running.append(pool.submit(time.sleep, 300.0))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        work_until_stopped()
    assert running[0].done()
    assert time.monotonic() - begin_s < 120.0
    assert multiprocessing.active_children() == []


def test_leaving_a_pool_waits_for_its_tasks():
    with WorkerPool(1) as pool:
        running = pool.submit(time.sleep, 0.2)
    assert running.exception() is None


def test_ctrl_c_while_a_worker_starts_is_for_the_parent():
    with WorkerPool(1) as pool:
        running = pool.submit(os.getpid)
        (worker,) = multiprocessing.active_children()
        os.kill(worker.pid, signal.SIGINT)
        assert running.result() == worker.pid
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())
