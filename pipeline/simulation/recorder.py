"""From plans to recordings on disk: several processes, finished moments kept, interrupted work taken up again."""

from __future__ import annotations

import os
import signal
from collections import deque
from collections.abc import Generator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from pipeline.base.errors import FileProblem, NotConverged, SettingProblem, TouchError
from pipeline.base.progress import SILENT, Cancelled, Progress
from pipeline.recordings import hdf5
from pipeline.recordings.hdf5_writer import Writer
from pipeline.simulation import datasets
from pipeline.simulation.datasets import Moment, Plan

BUBBLE_STEP_MM = 0.05  # depth readings are kept to this; their noise is eight times as much
WORTH_A_POOL = 8  # below so many moments, starting processes takes longer than they save
_AHEAD = 3  # moments in work or waiting per process


@dataclass(frozen=True, slots=True, kw_only=True)
class Recorded:
    """What one call of `record` added to a recording."""

    n_moments: int
    n_unsolved: int  # readings whose solve did not converge; they are in the recording without a truth


def file_of(plan: Plan, out: Path, n_plans: int) -> Path:
    """Where a plan's recording goes: `out` itself if it is one .h5, otherwise a file in the folder `out`.

    A recording holds one object mesh, so that several objects need a folder. Raises FileProblem.
    """
    if out.suffix == ".h5" and not out.is_dir():
        if n_plans > 1:
            raise FileProblem(f"{n_plans} objects make {n_plans} recordings; give a folder without .h5 as --out", out)
        return out
    if out.is_file():
        raise FileProblem("there is a file of this name; --out must be a folder or end in .h5", out)
    return out / f"{plan.thing_name}.h5"


def finished(plan: Plan, path: Path) -> int:
    """How many moments of `plan` the recording at `path` holds; raises FileProblem when something else is there."""
    if not path.exists():
        return 0
    try:
        recording = hdf5.read(path)
    except TouchError as error:
        raise FileProblem("a file that is no recording is there and is kept; choose another --out", path) from error
    try:
        counts = {stream.n_frames for stream in recording.streams}
        if datasets.told(plan) not in recording.notes or len(counts) != 1:
            raise FileProblem(
                "a recording made otherwise is there and is kept; choose another --out, or delete it", path
            )
        return counts.pop()
    finally:
        recording.close()


def record(plan: Plan, path: Path, *, pool: Executor | None = None, progress: Progress = SILENT) -> Recorded:
    """Simulate what `path` does not hold yet of `plan`, and write it.

    When `progress` cancels, or a process dies, finished moments are kept and the error goes on; calling again takes up
    from there. Raises FileProblem where nothing can be written or something else is there.
    """
    start, stopped, unsolved = finished(plan, path), None, 0
    if start == plan.poses:
        return Recorded(n_moments=0, n_unsolved=0)
    done = start
    with _writer(plan, path, start) as writer:
        try:
            with closing(_moments(plan, start, pool)) as moments:
                for moment in moments:
                    _append(writer, moment, path)
                    done, unsolved = done + 1, unsolved + moment.n_unsolved
                    progress.step(done / plan.poses, f"{plan.thing_name}: {done} of {plan.poses}")
        except Cancelled as error:
            stopped = error
        except BrokenProcessPool as error:
            stopped = NotConverged("a worker process died, perhaps for want of memory; run again with --jobs 1")
            stopped.__cause__ = error
        if stopped is not None and done == start:
            raise stopped  # inside: there is nothing new to keep
    if stopped is not None:
        raise stopped
    return Recorded(n_moments=done - start, n_unsolved=unsolved)


def workers(jobs: int) -> ProcessPoolExecutor:
    """A pool of fresh processes of one thread each; they leave Ctrl-C to their parent."""
    import multiprocessing

    if not 1 <= jobs <= 64:
        raise SettingProblem(f"--jobs must lie within 1 and 64, got {jobs}")
    return ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("spawn"), initializer=_begin_worker)


def _begin_worker() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.environ["OMP_NUM_THREADS"] = "1"
    import cv2
    import numba

    cv2.setNumThreads(1)
    numba.set_num_threads(1)


def _writer(plan: Plan, path: Path, start: int) -> Writer:
    if start:
        return Writer.appending(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    return Writer(
        path, object_mesh=datasets.thing(plan), symmetry=datasets.symmetry(plan), pairings=datasets.pairings(plan),
        notes=(datasets.told(plan),), coding="row differences", depth_step_mm=BUBBLE_STEP_MM,
    )  # fmt: skip


def _append(writer: Writer, moment: Moment, path: Path) -> None:
    try:
        for frame, truth in moment.readings:
            writer.append(frame.sensor, frame, truth)
    except OSError as error:
        raise FileProblem(f"the recording cannot be written on ({error}); check the free space", path) from error


def _moments(plan: Plan, start: int, pool: Executor | None) -> Generator[Moment, None, None]:
    """All moments from `start` on, in order; a few are worked out ahead when there is a pool."""
    if pool is None:
        for index in range(start, plan.poses):
            yield datasets.moment(plan, index)
        return
    waiting: deque[Future[Moment]] = deque()
    ahead = _AHEAD * getattr(pool, "_max_workers", 2)
    try:
        for index in range(start, plan.poses):
            waiting.append(pool.submit(datasets.moment, plan, index))
            if len(waiting) >= ahead:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        for future in waiting:
            future.cancel()
