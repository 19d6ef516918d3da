"""`tactoscope train`: train a network with progress on the terminal, and write its weights."""

import logging
import os
import shlex
import sys
from pathlib import Path
from typing import Annotated

from cyclopts import App, Parameter
from rich.console import Console

from pipeline.cli.terminal import open_progress_bar, print_line, print_table
from pipeline.cli.translation_options import Flag
from pipeline.core.errors import FileProblem, SettingProblem
from pipeline.lab.training.loop import TrainingRun
from pipeline.lab.training.loop import train as train_run
from pipeline.lab.training.recipe import (
    list_shipped_recipes,
    load_recipe,
    override_pairs,
    override_training,
)
from pipeline.lab.training.run_folder import export_run
from pipeline.lab.training.task import TASKS
from pipeline.stages.networks.weights import SUFFIX, Weights

WEIGHTS_FILE = f"weights{SUFFIX}"
_NETWORK_NAMES = tuple(dict.fromkeys(entry.subcommand for entry in TASKS.values()))
_NetworkName = Annotated[str, Parameter(help=f"What to train: {', '.join(_NETWORK_NAMES)}.")]
train_app = App(name="train")


@train_app.default
def train(
    what: _NetworkName,
    *,
    recipe: str = "",
    out: Path,
    initial_weights: Annotated[str, Parameter(name="--from")] = "",
    pairs: Path | None = None,
    hold_out: str = "",
    share: float = 1.0,
    resume: Flag = False,
    minutes: float | None = None,
    steps: int | None = None,
    seed: int | None = None,
    workers: int = 1,
) -> int:
    """Train on examples that are simulated on the fly, or on recorded pairs.

    Ctrl-C and SIGTERM keep the state, a kill loses a minute at most; the same command with --resume
    continues. Under `torchrun` each process takes one device and all train together.

    Args:
        recipe: Name of a shipped recipe, or a .toml file; with --pairs the default starts from
            shipped weights.
        out: Folder for the state, `curve.csv`, `figures.csv`, `curve.png` and
            `weights.safetensors`.
        initial_weights: Weights to start from, a file or the name of shipped ones, instead of the
            recipe's.
        pairs: Recording or folder of both sensors, such as touch2touch's `data`: trained on instead
            of simulated touches.
        hold_out: Pairs that only validate: `tool` for a quarter of the tools, names of tools
            separated by commas, `lab` or `paper` for published lists of tools, or a split.json;
            default: the splits of the folder, else `tool`.
        share: Share of the pairs to train on that is used, such as 0.1 to adapt a network to
            another sensor.
        resume: Continue the training in that folder.
        minutes: Training time in all, instead of the recipe's steps; the learning rate follows the
            clock.
        steps: Number of steps, instead of the recipe's.
        seed: Seed of weights and examples, instead of the recipe's.
        workers: Processes that make examples; 0 makes them in the main process.
    """
    known = {entry.subcommand for entry in TASKS.values()}
    if what not in known:
        raise SettingProblem(
            f"nothing called {what!r} can be trained; there are {', '.join(sorted(known))}"
        )
    if minutes is not None and not 0.0 < minutes <= 1e6:
        raise SettingProblem(f"--minutes must lie above 0 and at most a million, got {minutes:g}")
    if minutes is not None and steps is not None:
        raise SettingProblem("give either --minutes or --steps, not both")
    if not recipe and pairs is None:
        raise SettingProblem(
            f"name a recipe with --recipe: {', '.join(list_shipped_recipes(what))}"
        )
    if (hold_out or share != 1.0) and pairs is None:
        raise SettingProblem(f"{'--hold-out' if hold_out else '--share'} needs --pairs")
    chosen = load_recipe(recipe or f"{what}_pairs", what, initial_weights)
    if pairs is not None:
        chosen = override_pairs(chosen, os.fspath(pairs), hold_out, share)
    pace = {
        name: value for name, value in {"steps": steps, "seed": seed}.items() if value is not None
    }
    run = TrainingRun(
        recipe=override_training(chosen, **pace),
        folder=out,
        resume=resume,
        max_minutes=minutes,
        n_workers=workers,
        command=shlex.join(["tactoscope", *sys.argv[1:]]),
    )
    run_with_progress_bar(run)
    if os.environ.get("RANK", "0") == "0":
        _print_model_card(export_run(out, out / WEIGHTS_FILE))
        print_line(f"weights and model card are in {os.fspath(out / WEIGHTS_FILE)}")
    return 0


@train_app.command(name="export")
def export_weights(run: Path, *, to: Path, half: Flag = False) -> int:
    """Write the weights of a training, finished or not, with a model card.

    Args:
        run: Folder of the training.
        to: File for the weights (.safetensors); the model card is written next to it.
        half: Write 16-bit weights: half the size.
    """
    if to.suffix != SUFFIX:
        raise FileProblem(f"weights are written as {SUFFIX}; choose such a name", to)
    _print_model_card(export_run(run, to, half=half))
    print_line(f"{to.stat().st_size / 2**20:.2f} MiB in {os.fspath(to)}, with its model card")
    return 0


def run_with_progress_bar(run: TrainingRun) -> None:
    """Run a training with a progress bar.

    Ctrl-C and SIGTERM raise KeyboardInterrupt between two steps.
    """
    console = Console(stderr=True, quiet=os.environ.get("RANK", "0") != "0")
    log = logging.getLogger("tactoscope")
    handler = _ConsoleHandler(console)
    log.addHandler(handler)
    log.setLevel(logging.INFO)
    with open_progress_bar(console=console) as bar:
        bar.show("starting")
        try:
            train_run(run, bar)
        finally:
            log.removeHandler(handler)
            log.setLevel(logging.NOTSET)


def _print_model_card(weights: Weights) -> None:
    rows = ((name, value) for name, value in weights.card.items() if name != "recipe")
    print_table(("weights", f"{weights.kind}, {weights.n_parameters:,} parameters"), rows)


class _ConsoleHandler(logging.Handler):
    """Prints the training loop's messages above the progress bar."""

    def __init__(self, console: Console) -> None:
        super().__init__(logging.INFO)
        self._console = console

    def emit(self, record: logging.LogRecord) -> None:
        """Print one line."""
        style = "yellow" if record.levelno > logging.INFO else "dim"
        self._console.print(
            record.getMessage(), style=style, markup=False, highlight=False, soft_wrap=True
        )
