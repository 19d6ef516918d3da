"""Background work: newest wins, nothing gets lost."""

from __future__ import annotations

import threading
import time

import pytest
from PyQt6 import sip

from app.window.jobs import JobReporter, LatestJob
from pipeline.core import compiling

SOON_MS = 240_000


@pytest.fixture
def job(qtbot):
    made = LatestJob("test")
    yield made
    assert made.close()


def test_the_last_of_a_burst_is_always_delivered(job, qtbot):
    got: list[int] = []
    job.finished.connect(lambda _ticket, value: got.append(value))
    for i in range(500):
        job.submit(lambda _report, i=i: i)
    qtbot.waitUntil(lambda: bool(got) and got[-1] == 499, timeout=SOON_MS)
    assert got == sorted(got)


def test_a_runtime_error_is_delivered_like_any_other(job, qtbot):
    def fails(_report: JobReporter) -> None:
        raise RuntimeError("out of memory")

    with qtbot.waitSignal(job.failed, timeout=SOON_MS) as signal:
        job.submit(fails)
    assert isinstance(signal.args[1], RuntimeError)


def test_a_job_runs_after_one_that_failed(job, qtbot):
    with qtbot.waitSignal(job.failed, timeout=SOON_MS):
        job.submit(lambda _report: 1 // 0)
    with qtbot.waitSignal(job.finished, timeout=SOON_MS) as signal:
        job.submit(lambda _report: 7)
    assert signal.args[1] == 7


def test_cancelling_stops_the_work_at_its_next_step(job, qtbot):
    begun = threading.Event()

    def endless(report: JobReporter) -> None:
        while True:
            begun.set()
            report.step(0.5, "turning")

    ticket = job.submit(endless)
    assert begun.wait()
    with qtbot.waitSignal(job.cancelled, timeout=SOON_MS) as signal:
        job.cancel()
    assert signal.args[0] == ticket


def test_newer_work_interrupts_older_work(job, qtbot):
    begun = threading.Event()

    def endless(report: JobReporter) -> None:
        while True:
            begun.set()
            report.step(0.5, "turning")

    job.submit(endless)
    assert begun.wait()
    with qtbot.waitSignal(job.finished, timeout=SOON_MS) as signal:
        job.submit(lambda _report: "new")
    assert signal.args[1] == "new"


def test_a_job_without_interrupt_lets_the_running_one_finish(job, qtbot):
    begun = threading.Event()
    go = threading.Event()
    got: list[str] = []
    job.finished.connect(lambda _ticket, value: got.append(value))

    def first(_report: JobReporter) -> str:
        begun.set()
        go.wait()
        return "first"

    job.submit(first)
    assert begun.wait()
    job.submit(lambda _report: "second", interrupt=False)
    go.set()
    qtbot.waitUntil(lambda: got == ["first", "second"], timeout=SOON_MS)


def test_parts_arrive_before_the_result(job, qtbot):
    order: list[object] = []
    job.delivered.connect(lambda _ticket, part: order.append(part))
    job.finished.connect(lambda _ticket, value: order.append(value))

    def work(report: JobReporter) -> str:
        report.deliver("part")
        return "whole"

    job.submit(work)
    qtbot.waitUntil(lambda: order == ["part", "whole"], timeout=SOON_MS)


def test_nothing_runs_after_closing(qtbot):
    job = LatestJob("test")
    assert job.close()
    assert job.submit(lambda _report: 1) == 0
    assert not job.is_busy


def test_compiling_is_reported_at_the_current_fraction(job, qtbot):
    """A kernel that is compiled at its first call is reported at once, however recent the last
    report is.
    """
    reports: list[tuple[float, str]] = []
    job.progressed.connect(lambda _ticket, fraction, text: reports.append((fraction, text)))

    def works(report: JobReporter) -> None:
        report.step(0.25, "pose")
        compiling.begin_kernel()

    with qtbot.waitSignal(job.finished, timeout=SOON_MS):
        job.submit(works)
    assert reports[0] == (0.25, "pose")
    assert reports[1][0] == 0.25
    assert reports[1][1].startswith("compiling kernels")


def test_a_job_is_settled_once_its_end_was_received(job, qtbot):
    """Work that is done is not yet heard of: what it found waits in the queue of the window's
    thread.
    """
    got: list[object] = []
    job.finished.connect(lambda _ticket, value: got.append(value))
    assert job.is_settled
    job.submit(lambda _report: 7)
    while job.is_busy:  # no event is taken meanwhile
        time.sleep(0.001)
    assert (job.is_settled, got) == (False, [])
    qtbot.waitUntil(lambda: job.is_settled, timeout=SOON_MS)
    assert got == [7]


def test_a_job_that_outlives_its_window_ends_silently(qapp, monkeypatch):
    reports = []
    monkeypatch.setattr(threading, "excepthook", reports.append)
    job = LatestJob("late")
    begun = threading.Event()
    go_on = threading.Event()

    def late(_report):
        begun.set()
        go_on.wait()

    job.submit(late)
    assert begun.wait()
    assert not job.close(timeout_s=0.01)
    thread = job._thread
    sip.delete(job)
    go_on.set()
    thread.join()
    assert reports == []
