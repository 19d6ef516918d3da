"""`tactoscope simulate`: recordings from physics, one per object, resumable."""

from __future__ import annotations

import os
from collections.abc import Generator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

from pipeline.base.cluster import connect_cluster
from pipeline.base.errors import FileProblem
from pipeline.base.progress import Cancelled
from pipeline.cli.interrupts import handle_interrupts
from pipeline.cli.terminal import print_line
from pipeline.simulation import datasets, recorder
from pipeline.simulation.datasets import SimulationPlan


class _Bar:
    """Shows finished moments on the terminal; stops the work between two moments once asked to."""

    def __init__(self, bar: Progress, task: TaskID) -> None:
        self._bar, self._task, self._stop = bar, task, False

    def request_stop(self, *_signal: object) -> None:
        """Ask the work to stop."""
        self._stop = True
        self._bar.update(self._task, description="stopping")

    def step(self, fraction: float, text: str) -> None:  # noqa: ARG002 - the bar counts moments of all objects
        """One more moment is whole on its way to disk."""
        self._bar.update(self._task, advance=1, description=text)
        if self._stop:
            raise Cancelled


def simulate_recordings(tools: tuple[str, ...], like: SimulationPlan, out: Path, jobs: int, scheduler: str = "") -> int:
    """Simulate and write what is missing at `out`; Ctrl-C and SIGTERM end in KeyboardInterrupt, all finished kept."""
    plans = datasets.make_plans(tools, like)
    files = [recorder.resolve_recording_path(plan, out, len(plans)) for plan in plans]
    had = [recorder.count_finished_moments(plan, path) for plan, path in zip(plans, files, strict=True)]
    total = sum(plan.n_poses for plan in plans)
    if sum(had) == total:
        raise FileProblem("all of this is simulated already and is kept; choose another --out or --seed", out)
    left = total - sum(had)
    unsolved = 0
    with ExitStack() as open_now:
        local = open_now.enter_context(
            recorder.make_worker_pool(jobs)
        )  # checks the number; starts no process before there is work
        pool = open_now.enter_context(connect_cluster(scheduler)).pool if scheduler else local
        bar = open_now.enter_context(_bar(total, sum(had)))
        try:
            for plan, path in zip(plans, files, strict=True):
                worth_it = jobs > 1 and left >= recorder.MIN_MOMENTS_FOR_POOL
                shared = pool if scheduler or worth_it else None
                unsolved += recorder.record_plan(plan, path, pool=shared, progress=bar).n_unsolved
        except Cancelled:
            raise KeyboardInterrupt from None
    print_line(f"{total} moments of {len(plans)} objects for {', '.join(like.sensors)} in {os.fspath(out)}")
    if unsolved:
        print_line(f"{unsolved} readings did not converge; they are kept without a truth")
    return 0


@contextmanager
def _bar(total: int, had: int) -> Generator[_Bar, None, None]:
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as shown:
        bar = _Bar(shown, shown.add_task("simulating", total=total, completed=had))
        with handle_interrupts(bar.request_stop):
            yield bar
