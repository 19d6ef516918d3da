"""Worker processes: what leaves their pool."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import time
from contextlib import suppress

import pytest

from pipeline.core.processes import WorkerPool


def test_a_request_to_stop_ends_workers_that_are_busy():
    running = []

    def work_until_stopped() -> None:
        with WorkerPool(1) as pool:
            pool.submit(os.getpid).result()
            running.append(pool.submit(time.sleep, 300.0))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        work_until_stopped()
    assert running[0].done()
    assert multiprocessing.active_children() == []


def write_half_a_result(done):
    """Begin a message of 4,096 bytes as a worker does that sends its result, and do not end it."""
    frame = sys._getframe()
    while "result_queue" not in frame.f_locals:
        frame = frame.f_back
    os.write(frame.f_locals["result_queue"]._writer.fileno(), (4096).to_bytes(4, "big") + b"half")
    done.touch()
    time.sleep(300.0)


def stop_half_way(done):
    with suppress(KeyboardInterrupt), WorkerPool(1) as pool:
        pool.submit(write_half_a_result, done)
        while not done.exists():
            time.sleep(0.05)
        raise KeyboardInterrupt


def test_a_worker_that_ends_while_it_sends_a_result_does_not_keep_the_process(tmp_path):
    ended = multiprocessing.get_context("spawn").Process(
        target=stop_half_way, args=(tmp_path / "done",)
    )
    ended.start()
    try:
        ended.join()
        assert ended.exitcode == 0
    finally:
        ended.kill()  # one that did not end


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
