"""Run trials in worker processes; rollouts on disk are not run again."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from pipeline import __version__
from pipeline.core.digests import compute_digest
from pipeline.core.errors import SettingProblem
from pipeline.core.frozen import frozen
from pipeline.core.params import check_range
from pipeline.core.processes import WorkerPool, limit_threads
from pipeline.core.progress import SILENT, Progress
from pipeline.lab.tasks.rollout_file import read_summary, summarise, write_rollout
from pipeline.lab.tasks.task import Disturbance, TrialPlan, load_task
from pipeline.lab.tasks.touches import check_touch
from pipeline.lab.workers import map_ahead

# incremented when a plan gives another rollout: older ones on disk are run again then
TASKS_VERSION = 2
MAX_TRIALS = 10_000
Summary = Mapping[str, Any]


@frozen
class TrialJob:
    """One trial, and where its rollouts go; None = nowhere."""

    plan: TrialPlan
    folder: Path | None


def make_jobs(
    task_name: str,
    *,
    cases: Sequence[str] = (),
    touches: Sequence[str] = (),
    tolerances_mm: Sequence[float] = (),
    n_trials: int = 0,
    seed: int = 0,
    vary: float = 1.0,
    attribute: bool = False,
    disturbance: Disturbance | None = None,
    folder: Path | None = None,
) -> list[TrialJob]:
    """One job per case and trial.

    What is not given is the task's own. Raises SettingProblem and other TouchErrors.
    """
    is_file = task_name.endswith(".toml")
    task = load_task("insertion" if is_file else task_name)
    if is_file and task.load_case is not None:
        path = Path(task_name).resolve()
        task.load_case(path)
        task = replace(task, cases=(str(path),))
        cases = ()
    unknown = [case for case in cases if case not in task.cases]
    if unknown:
        raise SettingProblem(
            f"{task.name} has no case {unknown[0]!r}; there are {', '.join(task.cases)}"
        )
    check_range("--trials", n_trials or 1, 1, MAX_TRIALS)
    if any(not 0.0 < one <= 20.0 for one in tolerances_mm):
        raise SettingProblem("--tolerance-mm must lie above 0 and within 20 mm")
    check_range("--seed", seed, 0, (1 << 31) - 1)
    if disturbance not in (None, Disturbance()) and not task.holds_object:
        raise SettingProblem(f"--disturb changes a grasp, and {task.name} has none; leave it out")
    for touch in touches:
        if touch not in task.further_touches:
            check_touch(touch, task.source, task.target)
    return [
        TrialJob(
            plan=TrialPlan(
                task=task.name,
                case=case,
                index=index,
                touches=tuple(touches) or task.touches,
                tolerances_mm=tuple(tolerances_mm) or task.tolerances_mm,
                seed=seed,
                vary=vary,
                attribute=attribute,
                disturbance=disturbance or Disturbance(),
                record_frames=folder is not None,
            ),
            folder=folder,
        )
        for case in cases or task.cases
        for index in range(n_trials or task.n_trials)
    ]


def run_job(job: TrialJob) -> list[Summary]:
    """Run one trial and write its rollouts, or read those that are on disk.

    The summaries in the plan's order.
    """
    key = compute_digest((__version__, TASKS_VERSION, repr(asdict(job.plan))))
    finished = _read_finished(job, key)
    if finished is not None:
        return finished
    limit_threads()
    summaries: list[Summary] = []
    for rollout in load_task(job.plan.task).run(job.plan):
        if job.folder is not None:
            write_rollout(rollout, job.folder / f"{rollout.name}.h5", key, job.plan)
        summaries.append(summarise(rollout))
    return summaries


def _read_finished(job: TrialJob, key: str) -> list[Summary] | None:
    if job.folder is None:
        return None
    case = Path(job.plan.case).stem
    found = [
        read_summary(job.folder / f"{case}_{touch}_{tolerance:g}mm_{job.plan.index:03d}.h5", key)
        for touch in job.plan.touches
        for tolerance in job.plan.tolerances_mm
    ]
    return None if None in found else [one for one in found if one is not None]


def run_jobs(
    jobs: Sequence[TrialJob],
    n_processes: int,
    progress: Progress = SILENT,
) -> list[Summary]:
    """The summaries of all rollouts in the order of the jobs, however many processes run them.

    Whatever `progress` raises ends the run; rollouts on disk are complete and are not run again.
    """
    check_range("--jobs", n_processes, 1, 64)
    found: list[list[Summary]] = []

    def report() -> None:
        progress.step(len(found) / len(jobs), f"{len(found)} of {len(jobs)} trials")

    with WorkerPool(n_processes) as pool:
        for summaries in map_ahead(pool, run_job, jobs, len(jobs), "--jobs 1", report):
            found.append(summaries)
            report()
    return [one for summaries in found for one in summaries]
