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
from pipeline.base.files import ready
from pipeline.cli.terminal import Bar, print_line, shown_bar
from pipeline.cli.train import followed
from pipeline.networks.weights import save
from pipeline.training import export, own_unit, state
from pipeline.training.loop import Run
from pipeline.training.own_unit import LOOK_UP, SHIPPED, TAUGHT, Off, Presses

_SIMULATED = "simulated"  # pictures, in a lesson's folder


def taught(presses: Presses, out: Path, look_up: Path, *, seed: int, even_if_worse: bool) -> None:
    """Teach, judge on the presses held out, say which is best, and write the weights where they are.

    What was learned stays beside `out` until then, so that the same command goes on after Ctrl-C.
    """
    folder = _own_folder(out)
    with shown_bar() as bar:
        shown = own_unit.look_up_of(presses, seed=seed, progress=Bar(bar))
        recipe = own_unit.recipe(presses, shown, folder / _SIMULATED, seed=seed, progress=Bar(bar))
    command = shlex.join(["tactoscope", *sys.argv[1:]])
    followed(Run(recipe=recipe, out=folder, resume=True, workers=0, command=command))
    weights = export.weights_of(state.load(folder), out.stem)
    with shown_bar() as bar:
        off = own_unit.judged(presses, shown, weights, Bar(bar))
    won = own_unit.wins(off)
    print_line(
        f"network taught on {len(presses.learned)} presses beside their look-up; what is read of the "
        f"{len(presses.held)} held out:"
    )
    _report(off)
    best = min(off, key=lambda name: float(off[name].ball_mm.mean()))
    if won or even_if_worse:
        save(out, replace(weights, card={**weights.card, **_told(presses, off)}))
        print_line(
            f"{'the taught network is best: its' if won else _not_best(best) + ', written as asked:'} weights are in "
            f"{os.fspath(out)}; use them with --calibration {os.fspath(look_up)} --method depth=network "
            f"--weights depth={os.fspath(out)}"
        )
    else:
        instead = "read by --method depth=network without the look-up" if best == SHIPPED else "use the look-up"
        print_line(f"{_not_best(best)}: no weights are written; {instead}")
    shutil.rmtree(folder, ignore_errors=True)


def _own_folder(out: Path) -> Path:
    """The folder of a lesson, which is taken away in the end; raises FileProblem where it holds what is no lesson's."""
    folder = out.with_suffix(".run")
    if folder.is_dir() and any(folder.iterdir()) and not (state.is_there(folder) or (folder / _SIMULATED).is_dir()):
        raise FileProblem(
            "a folder that other things are kept in stands where the lesson would; choose another name for --network",
            folder,
        )
    ready(folder)
    return folder


def _not_best(best: str) -> str:
    if best == TAUGHT:
        return f"the taught network is nearer in the mean, but not in most presses, so that the {LOOK_UP} stands"
    return f"the {best} is best, the taught network is not"


def _report(off: dict[str, Off]) -> None:
    table = Table("read by", "off the ball (mm)", "diameter off (%)", "contact, IoU with the circle")
    for name, of in off.items():
        table.add_row(name, *_figures(of))
    Console().print(table)


def _figures(of: Off) -> tuple[str, str, str]:
    diameter = 100.0 * float(np.median(np.abs(of.diameter)))
    return f"{of.ball_mm.mean():.4f}", f"{diameter:.1f}", f"{1.0 - of.contact.mean():.3f}"


def _told(presses: Presses, off: dict[str, Off]) -> dict[str, str]:
    """What the card says of the presses held out."""
    names = ("off the ball, mm", "diameter off, %", "contact IoU")
    return {
        "unit": f"{presses.sensor.name}, {len(presses.learned)} presses of a ball of {presses.diameter_mm:g} mm, "
        f"{len(presses.held)} held out",
        **{
            f"held out: {what}, {name}": figure
            for name, of in off.items()
            for what, figure in zip(names, _figures(of), strict=True)
        },
        "remark": "corrects the look-up of this unit: use it together with that, as --calibration",
    }
