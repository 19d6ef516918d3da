"""From plans to recordings on disk: several processes, finished moments kept, interrupted work taken up again."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Generator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from pipeline.base.errors import FileProblem, NotConverged, SettingProblem, TouchError
from pipeline.base.processes import worker_pool
from pipeline.base.progress import SILENT, Cancelled, Progress
from pipeline.recordings import hdf5
from pipeline.recordings.hdf5_writer import RecordingWriter
from pipeline.simulation import datasets
from pipeline.simulation.datasets import SimulatedMoment, SimulationPlan
from pipeline.values.frames import Recording

BUBBLE_STEP_MM = 0.05  # depth readings are kept to this; their noise is eight times as much
MIN_MOMENTS_FOR_POOL = 8  # below so many moments, starting processes takes longer than they save
PUBLISH_INTERVAL_S = 30.0  # what is finished is in its place that soon; a recording of 1 GB is copied in some seconds
_AHEAD = 3  # moments in work or waiting per process


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordingResult:
    """What one call of `record` added to a recording."""

    n_moments: int
    n_unsolved: int  # readings whose solve did not converge; they are in the recording without a truth


def resolve_recording_path(plan: SimulationPlan, out: Path, n_plans: int) -> Path:
    """Where a plan's recording goes: `out` itself if it is one .h5, otherwise a file in the folder `out`.

    A recording holds one object mesh, so that several objects need a folder. Raises FileProblem.
    """
    if out.suffix == ".h5" and not out.is_dir():
        if n_plans > 1:
            raise FileProblem(f"{n_plans} objects make {n_plans} recordings; give a folder without .h5 as --out", out)
        return out
    if out.is_file():
        raise FileProblem("there is a file of this name; --out must be a folder or end in .h5", out)
    return out / f"{plan.object_name}.h5"


def count_finished_moments(plan: SimulationPlan, path: Path) -> int:
    """How many moments of `plan` the recording at `path` holds, up to the first that is damaged.

    Raises FileProblem when something else is there, or a file that is damaged beyond telling.
    """
    return _found(plan, path)[0]


def _found(plan: SimulationPlan, path: Path) -> tuple[int, bool]:
    """(moments that can be read and have none damaged before them, whether that is all there is)."""
    if not path.exists():
        return 0, True
    try:
        recording = hdf5.read(path)
    except TouchError as error:
        raise FileProblem(
            "a file that is no recording, or is damaged, is there and is kept; choose another --out, or delete it", path
        ) from error
    with closing(recording):
        if datasets.describe_plan(plan) not in recording.notes:
            raise FileProblem(
                "a recording made otherwise is there and is kept; choose another --out, or delete it", path
            )
        counts = [stream.n_frames for stream in recording.streams]
        good = next((k for k in range(min(counts)) if not _readable(recording, k)), min(counts))
        if any(hdf5.TRUTH_TABLE_TITLE in note and note.endswith(hdf5.DAMAGED_NOTE) for note in recording.notes):
            good = 0  # frames without their truth
        damaged = any(
            note.startswith(hdf5.TRUNCATED_NOTE) or note.endswith(hdf5.DAMAGED_NOTE) for note in recording.notes
        )
        return good, good == max(counts) and not damaged


def _readable(recording: Recording, index: int) -> bool:
    """Whether all that every sensor has of a moment is there; a moment without its time has lost its tables."""
    try:
        for stream in recording.streams:
            stream.truth(index)
            if not math.isfinite(stream.frame(index).time_s):
                return False
    except FileProblem:
        return False
    return True


def record_plan(
    plan: SimulationPlan, path: Path, *, pool: Executor | None = None, progress: Progress = SILENT
) -> RecordingResult:
    """Simulate what `path` does not hold yet of `plan`, and write it.

    What is finished is in its place every so often, so that not even a power cut costs much. When `progress` cancels,
    or a process dies, finished moments are kept and the error goes on; calling again takes up from there, also behind
    a part that is damaged. Raises FileProblem where nothing can be written or something else is there.
    """
    start, whole = _found(plan, path)
    if start and not whole:
        _mend(plan, path, start)
    done, unsolved, stopped = start, 0, None
    with closing(_moments(plan, start, pool)) as moments:
        while done < plan.n_poses and stopped is None:
            written, due_s = done, time.monotonic() + PUBLISH_INTERVAL_S
            with _writer(plan, path, done) as writer:
                try:
                    while done < plan.n_poses and (done == written or time.monotonic() < due_s):
                        moment = next(moments)
                        _append(writer, moment)
                        done, unsolved = done + 1, unsolved + moment.n_unsolved
                        progress.step(done / plan.n_poses, f"{plan.object_name}: {done} of {plan.n_poses}")
                except Cancelled as error:
                    stopped = error
                except BrokenProcessPool as error:
                    stopped = NotConverged("a worker process died, perhaps for want of memory; run again with --jobs 1")
                    stopped.__cause__ = error
                if stopped is not None and done == written:
                    raise stopped  # inside: there is nothing new to keep
    if stopped is not None:
        raise stopped
    return RecordingResult(n_moments=done - start, n_unsolved=unsolved)


def make_worker_pool(jobs: int) -> ProcessPoolExecutor:
    """A pool of fresh processes of one thread each; they leave Ctrl-C to their parent."""
    if not 1 <= jobs <= 64:
        raise SettingProblem(f"--jobs must lie within 1 and 64, got {jobs}")
    return worker_pool(jobs)


def _mend(plan: SimulationPlan, path: Path, n_moments: int) -> None:
    """Put the first moments of a damaged recording into a whole one that takes its place."""
    with closing(hdf5.read(path)) as damaged, _writer(plan, path, 0) as writer:
        for index in range(n_moments):
            for stream in damaged.streams:
                writer.append(stream.name, stream.frame(index), stream.truth(index))


def _writer(plan: SimulationPlan, path: Path, start: int) -> RecordingWriter:
    if start:
        return RecordingWriter.open_for_append(path)
    return RecordingWriter(
        path, object_mesh=datasets.load_object_mesh(plan), symmetry=datasets.load_object_symmetry(plan), pairings=datasets.compute_pairings(plan),
        notes=(datasets.describe_plan(plan),), coding="row differences", depth_step_mm=BUBBLE_STEP_MM,
    )  # fmt: skip


def _append(writer: RecordingWriter, moment: SimulatedMoment) -> None:
    for frame, truth in moment.frames:
        writer.append(frame.sensor, frame, truth)


def _moments(plan: SimulationPlan, start: int, pool: Executor | None) -> Generator[SimulatedMoment, None, None]:
    """All moments from `start` on, in order; a few are worked out ahead when there is a pool."""
    if pool is None:
        for index in range(start, plan.n_poses):
            yield datasets.simulate_moment(plan, index)
        return
    waiting: deque[Future[SimulatedMoment]] = deque()
    ahead = _AHEAD * getattr(pool, "_max_workers", 2)
    try:
        for index in range(start, plan.n_poses):
            waiting.append(pool.submit(datasets.simulate_moment, plan, index))
            if len(waiting) >= ahead:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        for future in waiting:
            future.cancel()
