"""Figures without a display, in matplotlib's own style."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pipeline.core.errors import SettingProblem
from pipeline.core.files import open_atomic

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.figure import Figure


def make_figure(**options: Any) -> Figure:
    """Return an empty figure with a canvas.

    A `matplotlibrc` in the current folder does not change it.
    """
    try:
        import matplotlib
    except UnicodeDecodeError as error:
        raise SettingProblem(
            "the file 'matplotlibrc' in the current folder is no text; rename it"
        ) from error
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    matplotlib.rcdefaults()
    figure = Figure(**options)
    FigureCanvasAgg(figure)
    return figure


def save_figure(figure: Figure, path: Path, what: str) -> None:
    """Write a figure as PNG, complete or not at all; raises FileProblem that names it `what`."""
    with open_atomic(path, what, None) as file:
        figure.savefig(file, format="png")
