"""`tactoscope rollout`: list, attribute, film and bundle recorded rollouts."""

import os
import shlex
from pathlib import Path

from pipeline.cli.terminal import format_number, open_progress_bar, print_line, print_table
from pipeline.lab.tasks.rerun import attribute_rollout, write_rollout_bundle
from pipeline.lab.tasks.rollout_file import read_rollout
from pipeline.lab.tasks.rollout_video import write_rollout_video
from pipeline.lab.tasks.task import describe_error, load_task
from pipeline.lab.tasks.trial_rows import list_trials

_COLUMNS = ("trial", "task", "case", "touch", "mm", "outcome", "error, mm", "error, deg", "cause")


def list_rollouts(folder: Path) -> int:
    """Print one row per rollout: outcome, error of the worst decision, and cause.

    Args:
        folder: Folder written by `tactoscope task --record`.
    """
    with open_progress_bar() as progress:
        trials = list_trials(folder, progress)
    print_table(
        _COLUMNS,
        (
            (
                str(trial.trial),
                trial.task,
                trial.case or trial.path.name,
                trial.touch,
                format_number(trial.tolerance_mm, "g"),
                trial.outcome,
                format_number(trial.error_mm, ".2f"),
                format_number(trial.error_deg, ".1f"),
                trial.problem or ": ".join(filter(None, (trial.cause, trial.share))),
            )
            for trial in trials
        ),
        width=200,
        most_letters=100,
    )
    return 0


def attribute_recorded(file: Path) -> int:
    """Print why a rollout fails: its error by stages, and the first truth with which it succeeds.

    Stored shares are printed; others are computed by running the rollout again from its plan.

    Args:
        file: A recorded rollout.
    """
    rollout = read_rollout(file)
    with open_progress_bar() as progress:
        decisions = attribute_rollout(rollout, progress)
    title = load_task(rollout.plan.task).error_title
    succeeds = rollout.summary.succeeds
    for decision in decisions:
        if decision.shares or len(decisions) == 1:
            print_line(
                f"tick {decision.tick}: {describe_error(decision, title, succeeds=succeeds)}"
            )
    return 0


def video(file: Path, *, out: Path) -> int:
    """Write scene, touches and force of every tick as a video.

    Args:
        file: A recorded rollout.
        out: Video to write, .mp4 or .avi.
    """
    with open_progress_bar() as progress:
        write_rollout_video(file, out, progress)
    print_line(f"video written to {os.fspath(out)}")
    return 0


def bundle(file: Path, *, out: Path, note: str = "") -> int:
    """Write a repro bundle: the rollout and what runs it again.

    Args:
        file: A recorded rollout.
        out: New folder to write.
        note: Description of the problem.
    """
    write_rollout_bundle(file, out, note=note)
    print_line(
        f"repro bundle written; replay it with: tactoscope replay {shlex.quote(os.fspath(out))}"
    )
    return 0
