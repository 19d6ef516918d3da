"""Recorded rollouts as rows of a table: what was tried, how it ended, and what was wrong at the
decision.
"""

import math
from pathlib import Path

from pipeline.core.errors import FileProblem, TouchError
from pipeline.core.frozen import frozen
from pipeline.core.progress import SILENT, Progress
from pipeline.lab.tasks.task import Decision, RolloutSummary

SUFFIXES = (".h5", ".hdf5")  # of recordings that may be rollouts
MAX_ROLLOUTS = 20_000  # of a folder
_CYCLE_DEG = 360.0


@frozen
class TrialRow:
    """One rollout; with a `problem` its file cannot be read, and nothing but the path is known."""

    path: Path
    task: str = ""
    case: str = ""
    trial: int = 0
    touch: str = ""
    tolerance_mm: float = math.nan
    succeeds: bool = False
    error_mm: float = math.nan  # of the worst decision
    error_deg: float = math.nan  # of the same decision; NaN where it has no angle
    cause: str = ""  # how it ended, without the decision
    share: str = ""  # largest share of the error, where it is attributed
    problem: str = ""

    @property
    def outcome(self) -> str:
        """One of "succeeds", "fails" and "damaged"."""
        return "damaged" if self.problem else "succeeds" if self.succeeds else "fails"


def is_rollout_folder(path: Path) -> bool:
    """Whether a folder holds HDF5 files and may hold rollouts; opens no file."""
    return path.is_dir() and any(one.suffix.lower() in SUFFIXES for one in path.iterdir())


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
        raise FileProblem(
            "this folder holds no rollout; `tactoscope task NAME --record FOLDER` writes some", path
        )
    return tuple(rows)


def _read_row(file: Path) -> TrialRow | None:
    """One row; None for an HDF5 file that is something else."""
    from pipeline.lab.tasks.rollout_file import may_be_rollout, read_outcome

    try:
        plan, summary = read_outcome(file)
    except TouchError as error:
        return TrialRow(path=file, problem=str(error)) if may_be_rollout(file) else None
    return make_row(file, plan.task, summary)


def make_row(path: Path, task: str, summary: RolloutSummary) -> TrialRow:
    """The row of one rollout."""
    worst = max(summary.decisions, key=lambda decision: decision.error_mm, default=None)
    share = max(worst.shares, key=lambda part: part.share_mm, default=None) if worst else None
    return TrialRow(
        path=path,
        task=task,
        case=summary.case,
        trial=summary.trial,
        touch=summary.touch,
        tolerance_mm=summary.tolerance_mm,
        succeeds=summary.succeeds,
        cause=summary.cause.partition(";")[0],
        error_mm=worst.error_mm if worst else math.nan,
        error_deg=compute_error_deg(worst) if worst else math.nan,
        share=f"{share.title} {share.share_mm:.1f} mm" if share else "",
    )


def compute_error_deg(decision: Decision) -> float:
    """The largest difference of an angle between estimate and truth in degrees.

    NaN without angles.
    """
    gaps = [
        abs(math.remainder(decision.estimate[name] - decision.truth[name], _CYCLE_DEG))
        for name in decision.estimate.keys() & decision.truth.keys()
        if name.endswith("_deg")
    ]
    return max(gaps, default=math.nan)
