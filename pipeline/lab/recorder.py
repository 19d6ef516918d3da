"""Writing simulated recordings: several processes, finished moments saved, interrupted work
continued.
"""

import math
import time
from collections.abc import Generator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import closing
from functools import partial
from pathlib import Path

from pipeline.core.errors import FileProblem, NotConverged, TouchError
from pipeline.core.frozen import frozen
from pipeline.core.params import check_range
from pipeline.core.processes import WorkerPool
from pipeline.core.progress import SILENT, Cancelled, Progress
from pipeline.core.values.frames import Recording
from pipeline.io import hdf5
from pipeline.io.hdf5_writer import RecordingWriter
from pipeline.lab.workers import map_ahead
from pipeline.physics.simulation import datasets
from pipeline.physics.simulation.datasets import SimulatedMoment, SimulationPlan

BUBBLE_STEP_MM = 0.05  # of stored depth frames; their noise is eight times as large
MIN_MOMENTS_FOR_POOL = 8  # starting processes takes longer than they save for fewer moments
# between writes into place; a recording of 1 GB is copied in some seconds
PUBLISH_INTERVAL_S = 30.0
_MOMENTS_AHEAD = 3  # for each process


@frozen
class RecordingResult:
    """What one call of `record_plan` added to a recording."""

    n_moments: int
    n_unsolved: int  # frames whose contact did not converge; they are recorded without a truth


def resolve_recording_path(plan: SimulationPlan, out: Path, n_plans: int) -> Path:
    """The path of a plan's recording: `out` itself for an .h5 file, otherwise a file in the folder
    `out`.

    A recording holds one object mesh, so that several objects need a folder. Raises FileProblem.
    """
    if out.suffix == ".h5" and not out.is_dir():
        if n_plans > 1:
            raise FileProblem(
                f"{n_plans} objects make {n_plans} recordings; give a folder without .h5 as --out",
                out,
            )
        return out
    if out.is_file():
        raise FileProblem("there is a file of this name; --out must be a folder or end in .h5", out)
    return out / f"{plan.object_name}.h5"


def count_finished_moments(plan: SimulationPlan, path: Path) -> int:
    """Number of moments of `plan` in the recording at `path`, up to the first damaged one.

    Raises FileProblem where another file is there, or one too damaged to recognise.
    """
    return _inspect_file(plan, path)[0]


def _inspect_file(plan: SimulationPlan, path: Path) -> tuple[int, bool]:
    """(moments before the first damaged one, whether the file holds nothing else)."""
    if not path.exists():
        return 0, True
    try:
        recording = hdf5.read(path)
    except TouchError as error:
        raise FileProblem(
            "there is a file that is damaged or no recording; it is kept, choose another --out or "
            "delete it",
            path,
        ) from error
    with closing(recording):
        if datasets.describe_plan(plan) not in recording.notes:
            raise FileProblem(
                "there is a recording of another plan; it is kept, choose another --out or delete "
                "it",
                path,
            )
        counts = [stream.n_frames for stream in recording.streams]
        good = next((k for k in range(min(counts)) if not _is_readable(recording, k)), min(counts))
        damaged = [note for note in recording.notes if note.endswith(hdf5.DAMAGED_NOTE)]
        if any(hdf5.TRUTH_TABLE_TITLE in note for note in damaged):
            good = 0  # frames without their truth
        is_cut = any(note.startswith(hdf5.TRUNCATED_NOTE) for note in recording.notes)
        return good, good == max(counts) and not (damaged or is_cut)


def _is_readable(recording: Recording, index: int) -> bool:
    """Whether frames and truth of all sensors can be read.

    A moment without its time has lost its tables.
    """
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
    """Simulate and write the moments of `plan` that `path` does not hold yet.

    Finished moments are written into place at intervals. When `progress` cancels or a process dies,
    they are saved and the error passes on; the next call continues from there, and from the first
    damaged moment of a damaged file. Raises FileProblem where the file cannot be written or another
    one is there.
    """
    start, complete = _inspect_file(plan, path)
    if start and not complete:
        _repair(plan, path, start)
    done = start
    unsolved = 0
    stopped = None
    with closing(_iterate_moments(plan, start, pool)) as moments:
        while done < plan.n_poses and stopped is None:
            written = done
            due_s = time.monotonic() + PUBLISH_INTERVAL_S
            with _open_writer(plan, path, done) as writer:
                try:
                    while done < plan.n_poses and (done == written or time.monotonic() < due_s):
                        moment = next(moments)
                        for frame, truth in moment:
                            writer.append(frame.sensor, frame, truth)
                            unsolved += truth is None
                        done += 1
                        progress.step(
                            done / plan.n_poses, f"{plan.object_name}: {done} of {plan.n_poses}"
                        )
                except (Cancelled, KeyboardInterrupt, NotConverged) as error:
                    stopped = error
                if stopped is not None and done == written:
                    raise stopped  # inside the writer: nothing new to save
    if stopped is not None:
        raise stopped
    return RecordingResult(n_moments=done - start, n_unsolved=unsolved)


def make_worker_pool(jobs: int) -> ProcessPoolExecutor:
    """A pool of single-threaded processes that ignore Ctrl-C, which their parent handles."""
    check_range("--jobs", jobs, 1, 64)
    return WorkerPool(jobs)


def _repair(plan: SimulationPlan, path: Path, n_moments: int) -> None:
    """Replace a damaged recording by its first moments."""
    with closing(hdf5.read(path)) as damaged, _open_writer(plan, path, 0) as writer:
        for index in range(n_moments):
            for stream in damaged.streams:
                writer.append(stream.name, stream.frame(index), stream.truth(index))


def _open_writer(plan: SimulationPlan, path: Path, start: int) -> RecordingWriter:
    if start:
        return RecordingWriter.open_for_append(path)
    return RecordingWriter(
        path,
        object_mesh=datasets.load_object_mesh(plan),
        symmetry=datasets.load_object_symmetry(plan),
        pairings=datasets.compute_pairings(plan),
        notes=(datasets.describe_plan(plan),),
        coding="row differences",
        depth_step_mm=BUBBLE_STEP_MM,
    )


def _iterate_moments(
    plan: SimulationPlan, start: int, pool: Executor | None
) -> Generator[SimulatedMoment, None, None]:
    """All moments from `start` on, in order; a pool simulates a few ahead."""
    ahead = _MOMENTS_AHEAD * getattr(pool, "_max_workers", 2)
    simulate = partial(datasets.simulate_moment, plan)
    return map_ahead(pool, simulate, range(start, plan.n_poses), ahead, "--jobs 1")
