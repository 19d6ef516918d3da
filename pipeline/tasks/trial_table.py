"""Recorded rollouts of a folder as rows: what was tried, how it ended, and what was wrong at the decision."""

from pathlib import Path

from pipeline.base.errors import FileProblem, TouchError
from pipeline.base.progress import SILENT, Progress
from pipeline.tasks.rollout_file import may_be_rollout, read_outcome
from pipeline.tasks.trial_rows import SUFFIXES, TrialRow, make_row

MAX_ROLLOUTS = 20_000


def list_trials(path: Path, progress: Progress = SILENT) -> tuple[TrialRow, ...]:
    """The rollouts of a folder in order of their names, or of the folder that a rollout lies in.

    A damaged rollout is a row with its problem. Raises FileProblem where there is no rollout.
    """
    folder = path if path.is_dir() else path.parent
    files = sorted(one for one in folder.iterdir() if one.suffix.lower() in SUFFIXES)[:MAX_ROLLOUTS]
    rows: list[TrialRow] = []
    for done, file in enumerate(files):
        progress.step(done / len(files), f"rollout {done + 1} of {len(files)}")
        row = _read_row(file)
        if row is not None:
            rows.append(row)
    if not any(not row.problem for row in rows) and not (path.is_file() and rows):
        raise FileProblem("this folder holds no rollout; `tactoscope task NAME --record FOLDER` writes some", path)
    return tuple(rows)


def _read_row(file: Path) -> TrialRow | None:
    """One row; None for an HDF5 file that is something else."""
    try:
        plan, summary = read_outcome(file)
    except TouchError as error:
        return TrialRow(path=file, problem=str(error)) if may_be_rollout(file) else None
    return make_row(file, plan.task, summary)
