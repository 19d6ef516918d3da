"""Learning curves as tables and as a figure."""

import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pipeline.core.figures import make_figure, save_figure
from pipeline.core.files import write_text
from pipeline.lab.training.state import TrainingState

_INCHES = (9.0, 3.0)
_DPI = 110
_COLOURS = {"unseen_grasps": "#0b6e99", "unseen_tools": "#8a4b12"}


def write_tables(folder: Path, state: TrainingState) -> None:
    """Write `curve.csv` (loss and its terms) and `figures.csv` (step, split, name, value).

    Raises FileProblem.
    """
    _write_table(folder / "curve.csv", state.curve)
    _write_table(folder / "figures.csv", state.metrics)


def _write_table(path: Path, rows: Sequence[dict[str, Any]]) -> None:
    names = list(dict.fromkeys(name for row in rows for name in row))
    text = io.StringIO()
    table = csv.DictWriter(text, names, lineterminator="\n")
    table.writeheader()
    table.writerows(
        {k: f"{v:.6g}" if isinstance(v, float) else v for k, v in row.items()} for row in rows
    )
    write_text(path, text.getvalue(), "the learning curves", None)


def draw_curves(folder: Path, state: TrainingState) -> None:
    """Write `curve.png`: the loss, and below it every validation metric; raises FileProblem."""
    names = list(dict.fromkeys(str(row["name"]) for row in state.metrics))
    figure = make_figure(
        figsize=(_INCHES[0], _INCHES[1] * (1 + len(names))), dpi=_DPI, layout="constrained"
    )
    axes: Any = figure.subplots(1 + len(names), 1, squeeze=False, sharex=True)[:, 0]
    axes[0].plot(
        [row["step"] for row in state.curve],
        [row["loss"] for row in state.curve],
        color="#374151",
        lw=1.0,
    )
    axes[0].set(
        ylabel="loss",
        title=f"{state.n_examples:,} examples in {state.trained_s / 60.0:.0f} minutes",
    )
    if state.curve and min(row["loss"] for row in state.curve) > 0:
        axes[0].set_yscale("log")
    for axis, name in zip(axes[1:], names, strict=True):
        for split, colour in _COLOURS.items():
            rows = [row for row in state.metrics if row["name"] == name and row["split"] == split]
            label = split.replace("_", " ")
            axis.plot(
                [row["step"] for row in rows],
                [row["value"] for row in rows],
                "o-",
                ms=3,
                color=colour,
                label=label,
            )
        axis.set(ylabel=name)
        axis.legend(frameon=False)
    axes[-1].set(xlabel="step")
    for axis in axes:
        axis.grid(visible=True, color="#e5e7eb", lw=0.8)
        axis.spines[["top", "right"]].set_visible(False)
    save_figure(figure, folder / "curve.png", "the learning curves")
