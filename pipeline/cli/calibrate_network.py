"""`tactoscope calibrate balls --network`: the network taught on the presses, judged beside the look-up."""

from __future__ import annotations

import os
import shlex
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from pipeline.base.errors import FileProblem
from pipeline.base.files import prepare_folder
from pipeline.cli.terminal import ProgressBar, create_progress_bar, print_line
from pipeline.cli.train import run_with_progress_bar
from pipeline.networks.weights import save_weights
from pipeline.training import export, instance_network, state
from pipeline.training.instance_network import (
    CALIBRATION_TABLE,
    SHIPPED_NETWORK,
    TRAINED_NETWORK,
    BallErrors,
    InstancePresses,
)
from pipeline.training.loop import TrainingRun

_SIMULATED = "simulated"  # pictures, in a lesson's folder


def train_network(presses: InstancePresses, out: Path, look_up: Path, *, seed: int, even_if_worse: bool) -> None:
    """Teach, judge on the presses held out, say which is best, and write the weights where they are.

    What was learned stays beside `out` until then, so that the same command goes on after Ctrl-C.
    """
    folder = _own_folder(out)
    with create_progress_bar() as bar:
        shown = instance_network.fit_training_calibration(presses, seed=seed, progress=ProgressBar(bar))
        recipe = instance_network.make_recipe(presses, shown, folder / _SIMULATED, seed=seed, progress=ProgressBar(bar))
    command = shlex.join(["tactoscope", *sys.argv[1:]])
    run_with_progress_bar(TrainingRun(recipe=recipe, folder=folder, resume=True, n_workers=0, command=command))
    weights = export.make_weights(state.load_state(folder), out.stem)
    with create_progress_bar() as bar:
        off = instance_network.evaluate_on_validation(presses, shown, weights, ProgressBar(bar))
    won = instance_network.is_trained_best(off)
    print_line(
        f"network taught on {len(presses.training_indices)} presses beside their look-up; what is read of the "
        f"{len(presses.validation_indices)} held out:"
    )
    _report(off)
    best = min(off, key=lambda name: float(off[name].shape_rms_mm.mean()))
    if won or even_if_worse:
        save_weights(out, replace(weights, card={**weights.card, **_told(presses, off)}))
        print_line(
            f"{'the taught network is best: its' if won else _not_best(best) + ', written as asked:'} weights are in "
            f"{os.fspath(out)}; use them with --calibration {os.fspath(look_up)} --method depth=network "
            f"--weights depth={os.fspath(out)}"
        )
    else:
        instead = "read by --method depth=network without the look-up" if best == SHIPPED_NETWORK else "use the look-up"
        print_line(f"{_not_best(best)}: no weights are written; {instead}")
    shutil.rmtree(folder, ignore_errors=True)


def _own_folder(out: Path) -> Path:
    """The folder of a lesson, which is taken away in the end; raises FileProblem where it holds what is no lesson's."""
    folder = out.with_suffix(".run")
    if folder.is_dir() and any(folder.iterdir()) and not (state.has_state(folder) or (folder / _SIMULATED).is_dir()):
        raise FileProblem(
            "a folder that other things are kept in stands where the lesson would; choose another name for --network",
            folder,
        )
    prepare_folder(folder)
    return folder


def _not_best(best: str) -> str:
    if best == TRAINED_NETWORK:
        return (
            f"the taught network is nearer in the mean, but not in most presses, so that the {CALIBRATION_TABLE} stands"
        )
    return f"the {best} is best, the taught network is not"


def _report(off: dict[str, BallErrors]) -> None:
    table = Table("read by", "off the ball (mm)", "diameter off (%)", "contact, IoU with the circle")
    for name, of in off.items():
        table.add_row(name, *_figures(of))
    Console().print(table)


def _figures(of: BallErrors) -> tuple[str, str, str]:
    diameter = 100.0 * float(np.median(np.abs(of.diameter_error)))
    return f"{of.shape_rms_mm.mean():.4f}", f"{diameter:.1f}", f"{1.0 - of.contact_error.mean():.3f}"


def _told(presses: InstancePresses, off: dict[str, BallErrors]) -> dict[str, str]:
    """What the card says of the presses held out."""
    names = ("off the ball, mm", "diameter off, %", "contact IoU")
    return {
        "unit": f"{presses.sensor.name}, {len(presses.training_indices)} presses of a ball of {presses.diameter_mm:g} mm, "
        f"{len(presses.validation_indices)} held out",
        **{
            f"held out: {what}, {name}": figure
            for name, of in off.items()
            for what, figure in zip(names, _figures(of), strict=True)
        },
        "remark": "corrects the look-up of this unit: use it together with that, as --calibration",
    }
