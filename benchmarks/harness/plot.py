"""Plot a benchmark: run time against error, both logarithmic, one marker per method."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.harness.results import BenchmarkResult, Measurement, PlotPoint
from pipeline.core.figures import make_figure
from pipeline.core.files import open_atomic

_OURS = "#0b6e99"
_BAR = "#6b7280"
_INCHES = (8.4, 5.2)
_DPI = 120
_MARGIN = 3.0  # factor of empty space around the points


def plot_result(result: BenchmarkResult, path: Path) -> bool:
    """Draw the result as a PNG; False, and no file, where no method has both a time and an error.

    The points are the result's own, or else those of its rows in its unit. Shaded is where a point
    clears a row's bar. An error of exactly zero has no place on a logarithmic axis: it stands on
    the lowest line, which says so. Raises FileProblem where the image cannot be written.
    """
    points = [p for p in result.points or collect_points(result) if _drawable(p)]
    if not points:
        return False

    figure = make_figure(figsize=_INCHES, dpi=_DPI, layout="constrained")
    axes: Any = figure.add_subplot()
    floor = _floor([p.error for p in points])
    bars = [row for row in result.rows if _shown(row, points)]
    _axes(axes, result, points, bars, floor)
    _bars(axes, bars, floor)
    for point in points:
        label = {
            "label": point.method,
            "color": _OURS if point.ours else None,
            "mec": "white",
            "ls": "",
            "zorder": 4,
        }
        axes.plot(
            [point.ms],
            [point.error or floor],
            "o" if point.ours else "s",
            ms=8 if point.ours else 7,
            **label,
        )
    _zero_line(axes, points, floor)
    figure.legend(loc="outside right upper", fontsize=8, frameon=False)
    with open_atomic(path, "the plot", None) as file:
        figure.savefig(file, format="png")
    return True


def collect_points(result: BenchmarkResult) -> tuple[PlotPoint, ...]:
    """The methods of a result's rows whose errors are in its unit: each baseline once, ours once
    per benchmark.
    """
    found: dict[tuple[str, float, float], PlotPoint] = {}
    for row in result.rows:
        if row.unit != result.unit:
            continue
        ours = PlotPoint(
            method=f"ours: {row.question}", ms=row.ours_ms, error=row.ours_error, ours=True
        )
        found.setdefault((ours.method, 0.0, 0.0), ours)
        if row.peer:
            peer = PlotPoint(method=row.peer, ms=row.peer_ms, error=row.peer_error)
            found.setdefault((row.peer, row.peer_ms, row.peer_error), peer)
    return tuple(found.values())


def _drawable(point: PlotPoint) -> bool:
    return (
        math.isfinite(point.ms) and point.ms > 0 and math.isfinite(point.error) and point.error >= 0
    )


def _shown(row: Measurement, points: Sequence[PlotPoint]) -> bool:
    """Whether the row's own method is among the points.

    Only then does its bar belong in the image.
    """
    return any(p.ours and (p.ms, p.error) == (row.ours_ms, row.ours_error) for p in points)


def _floor(errors: Sequence[float]) -> float:
    """Where an error of zero is drawn: a power of ten below all others."""
    least = min((e for e in errors if e > 0), default=1.0)
    return 10.0 ** (math.floor(math.log10(least)) - 1)


def _axes(
    axes: Any,
    result: BenchmarkResult,
    points: Sequence[PlotPoint],
    bars: Sequence[Measurement],
    floor: float,
) -> None:
    errors = [p.error for p in points if p.error > 0] or [10 * floor]
    errors += [row.limit_error for row in bars if row.limit_error > 0]
    times = [p.ms for p in points] + [row.limit_ms for row in bars if row.limit_ms > 0]
    zero = any(p.error == 0 for p in points)
    axes.set(
        xscale="log",
        yscale="log",
        title=result.title,
        xlabel="run time [ms], median",
        ylabel=f"error [{result.unit}]" if result.unit else "error",
        xlim=(min(times) / _MARGIN, max(times) * _MARGIN**2),
        ylim=(floor / 2 if zero else min(errors) / _MARGIN, max(errors) * _MARGIN),
    )
    axes.title.set(fontsize=11, fontweight="bold", ha="left", x=0.0, wrap=True)
    axes.grid(visible=True, which="major", color="#e5e7eb", lw=0.8)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def _bars(axes: Any, rows: Sequence[Measurement], floor: float) -> None:
    """Shade where each of our points clears all bars that it is held to."""
    (left, right), (low, top) = axes.get_xlim(), axes.get_ylim()
    held: dict[tuple[float, float], list[Measurement]] = {}
    for row in rows:
        if math.isfinite(row.limit_ms) or math.isfinite(row.limit_error):
            held.setdefault((row.ours_ms, row.ours_error), []).append(row)
    drawn: dict[tuple[float, float], str] = {}
    for claims in held.values():
        ms = min((row.limit_ms for row in claims if math.isfinite(row.limit_ms)), default=right)
        error = min(
            (row.limit_error for row in claims if math.isfinite(row.limit_error)), default=top
        )
        # A required error of exactly zero is met on the line where errors of zero are drawn.
        drawn[ms, error or 1.5 * floor] = " and ".join(dict.fromkeys(row.bar for row in claims))
    for k, ((ms, error), words) in enumerate(drawn.items()):
        axes.fill_between([left, ms], low, error, color=_BAR, alpha=0.10, lw=0)
        axes.plot(
            [left, ms, ms],
            [error, error, low],
            color=_BAR,
            lw=1.0,
            ls="--",
            scalex=False,
            scaley=False,
        )
        axes.annotate(
            f"bar: {words}",
            (left, error),
            xytext=(4, 3 + 10 * k),
            textcoords="offset points",
            fontsize=7.5,
            color=_BAR,
            annotation_clip=True,
        )


def _zero_line(axes: Any, points: Sequence[PlotPoint], floor: float) -> None:
    if all(p.error > 0 for p in points):
        return
    axes.axhline(floor, color=_BAR, lw=0.8, ls=":")
    axes.annotate(
        "no error at all (0 has no place on this axis)",
        (0.0, floor),
        xycoords=("axes fraction", "data"),
        xytext=(4, 3),
        textcoords="offset points",
        fontsize=7.5,
        color=_BAR,
    )
