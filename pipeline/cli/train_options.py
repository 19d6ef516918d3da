"""The options of `tactoscope train`: one command for all that can be learned, and one that writes the weights."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from cyclopts import App

from pipeline.cli.translation_options import Flag


def build_train_app() -> App:
    """`train` with a command for each thing that `pipeline.training.task.TASKS` learns."""
    from pipeline.training.task import TASKS

    app = App(name="train", help="Train the networks, and write their weights.")
    for what in dict.fromkeys(entry.subcommand for entry in TASKS.values()):
        app.command(_command(what), name=what)
    app.command(export)
    return app


def _command(what: str) -> Callable[..., int]:
    def learn(
        *,
        recipe: str,
        out: Path,
        resume: Flag = False,
        minutes: float | None = None,
        steps: int | None = None,
        seed: int | None = None,
        workers: int = 1,
    ) -> int:
        """Learn from examples that are simulated on the fly.

        Ctrl-C and SIGTERM keep all that was learned, a kill costs a minute at most; with --resume the same command goes
        on from there. Started by `torchrun`, every process takes a device and all learn as one.

        Parameters
        ----------
        recipe
            Name of a recipe that comes along, or a .toml file.
        out
            Folder for the state, `curve.csv`, `figures.csv`, `curve.png` and `weights.safetensors`.
        resume
            Go on with what is in that folder.
        minutes
            How long to train in all, in place of the recipe's steps; the learning rate follows the clock.
        steps
            How many steps, in place of the recipe's.
        seed
            Seed of weights and examples, in place of the recipe's.
        workers
            Processes that make examples; 0 makes them in this one.
        """
        from pipeline.cli.train import run_training

        return run_training(what, recipe, out, resume=resume, minutes=minutes, steps=steps, seed=seed, workers=workers)

    return learn


def export(run: Path, *, to: Path, half: Flag = False) -> int:
    """Write the weights of a training, finished or not, with a card that says how they came about.

    Parameters
    ----------
    run
        Folder that a training writes to.
    to
        File for the weights (.safetensors); the card is written beside it.
    half
        Keep the weights in 16 bits: half the size.
    """
    from pipeline.cli.train import export_weights

    return export_weights(run, to, half=half)
