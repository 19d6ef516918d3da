"""`tactoscope train`: a run with its progress on the terminal, and the weights that it ends in."""

from __future__ import annotations

import logging
import os
import shlex
import sys
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TaskProgressColumn, TextColumn, TimeRemainingColumn
from rich.table import Table

from pipeline.base.errors import FileProblem, SettingProblem
from pipeline.cli.interrupts import handle_interrupts
from pipeline.cli.terminal import print_line
from pipeline.networks.weights import SUFFIX, Weights
from pipeline.training.export import export_run
from pipeline.training.loop import TrainingRun
from pipeline.training.loop import train as train_run
from pipeline.training.recipe import load_recipe, override_training

WEIGHTS_FILE = f"weights{SUFFIX}"


class _Bar:
    """Shows how far a run is; ends it between two steps once asked to."""

    def __init__(self, bar: Progress, task: TaskID) -> None:
        self._bar, self._task, self._stop = bar, task, False

    def request_stop(self, *_signal: object) -> None:
        """Ask the run to stop."""
        self._stop = True
        self._bar.update(self._task, description="stopping")

    def step(self, fraction: float, text: str) -> None:
        """Show, or end."""
        self._bar.update(self._task, completed=fraction, description=text)
        if self._stop:
            raise KeyboardInterrupt


def run_training(
    what: str,
    recipe: str,
    out: Path,
    *,
    resume: bool,
    minutes: float | None,
    steps: int | None,
    seed: int | None,
    workers: int,
) -> int:
    """Run a training to its end and write its weights; Ctrl-C and SIGTERM end in KeyboardInterrupt, all of it kept."""
    if minutes is not None and not 0.0 < minutes <= 1e6:
        raise SettingProblem(f"--minutes must lie above 0 and at most a million, got {minutes:g}")
    if minutes is not None and steps is not None:
        raise SettingProblem("give either --minutes or --steps, not both")
    pace = {name: value for name, value in (("steps", steps), ("seed", seed)) if value is not None}
    run = TrainingRun(
        recipe=override_training(load_recipe(recipe, what), **pace), folder=out, resume=resume, max_minutes=minutes, n_workers=workers,
        command=shlex.join(["tactoscope", *sys.argv[1:]]),
    )  # fmt: skip
    run_with_progress_bar(run)
    if os.environ.get("RANK", "0") == "0":
        print_model_card(export_run(out, out / WEIGHTS_FILE))
        print_line(f"weights and their card are in {os.fspath(out / WEIGHTS_FILE)}")
    return 0


def run_with_progress_bar(run: TrainingRun) -> None:
    """Run a training with a bar on the terminal; Ctrl-C and SIGTERM end it between two steps in KeyboardInterrupt."""
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")  # before torch loads: idle threads leave the processor alone
    console = Console(stderr=True, quiet=os.environ.get("RANK", "0") != "0")
    log, told = logging.getLogger("tactoscope"), _Told(console)
    log.addHandler(told)
    log.setLevel(logging.INFO)
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as shown:
        bar = _Bar(shown, shown.add_task("beginning", total=1.0))
        try:
            with handle_interrupts(bar.request_stop):
                train_run(run, bar)
        finally:
            log.removeHandler(told)
            log.setLevel(logging.NOTSET)


def export_weights(run: Path, to: Path, *, half: bool) -> int:
    """Write the weights of a run."""
    if to.suffix != SUFFIX:
        raise FileProblem(f"weights are kept in a {SUFFIX} file; choose such a name", to)
    print_model_card(export_run(run, to, half=half))
    print_line(f"{to.stat().st_size / 2**20:.2f} MiB in {os.fspath(to)}, its card beside it")
    return 0


def print_model_card(weights: Weights) -> None:
    """Print the card."""
    table = Table("weights", f"{weights.kind}, {weights.n_parameters:,} numbers")
    for name, value in weights.card.items():
        if name != "recipe":
            table.add_row(name, value)
    Console().print(table)


class _Told(logging.Handler):
    """What the loop says, above the bar: figures as they come, and warnings."""

    def __init__(self, console: Console) -> None:
        super().__init__(logging.INFO)
        self._console = console

    def emit(self, record: logging.LogRecord) -> None:
        """Print one line."""
        self._console.print(
            record.getMessage(),
            style="yellow" if record.levelno > logging.INFO else "dim",
            markup=False,
            highlight=False,
            soft_wrap=True,
        )
