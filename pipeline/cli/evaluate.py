"""`tactoscope evaluate`: the paper's tables, its figures beside ours, and run time against error."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path

from rich.console import Console
from rich.table import Table as Shown

from pipeline.base.elsewhere import workers_of
from pipeline.base.files import ready, ready_for, write_json
from pipeline.base.progress import Progress, Share
from pipeline.cli.stopping import Stoppable, stoppable
from pipeline.cli.terminal import Bar, print_line, shown_bar
from pipeline.evaluation.metrics import Metric
from pipeline.racing.machine import machine, machine_line
from pipeline.scoring.compared import REGIONS
from pipeline.scoring.evaluation import Table, Wanted, evaluated
from pipeline.scoring.figures import FIGURES
from pipeline.scoring.paper import Spread
from pipeline.scoring.sweep import Point, drawn, must_be_swept, swept
from pipeline.scoring.table import Row
from pipeline.sensors.spec import sensor

_POSES = {"signed_distances": "registration", "network": "network"}


class _Watched:
    """A bar that Ctrl-C ends between two steps."""

    def __init__(self, bar: Bar, work: Stoppable) -> None:
        self._bar, self._work = bar, work

    def step(self, fraction: float, text: str) -> None:
        """Show, or end."""
        self._work.step(fraction, text)
        self._bar.step(fraction, text)


def evaluate(wanted: Wanted, json: Path | None, sweep: Sequence[str], plots: Path | None, scheduler: str) -> int:
    """Score, here or on a scheduler's workers, print and write; returns the exit code."""
    must_be_swept(sweep)
    if json is not None:
        ready_for(json)
    if plots is not None:
        ready(plots)
    about = machine()
    points: list[Point] = []
    with ExitStack() as open_now:
        work, bar = open_now.enter_context(stoppable()), open_now.enter_context(shown_bar())
        elsewhere = open_now.enter_context(workers_of(scheduler)).map if scheduler else None
        watched: Progress = _Watched(Bar(bar), work)
        table = evaluated(wanted, Share(watched, 0.0, 0.5 if sweep else 1.0), elsewhere)
        if sweep:
            points = swept(wanted, sweep, Share(watched, 0.5, 0.5), elsewhere)
    _show(table)
    if sweep:
        _show_sweep(points)
    print_line(machine_line(about))
    if json is not None:
        write_json(json, _as_json(table, points, wanted, about), "the tables")
    for path in drawn(points, plots) if plots is not None and points else ():
        print_line(f"drawn: {path}")
    return 0


def _show(table: Table) -> None:
    console, judges = Console(width=200), list(dict.fromkeys(name for row in table.rows for name in row.poses))
    first = Shown(title=f"{table.split.replace('_', ' ')}: ours, simulated (the paper's, real)")
    for column in ("transfer", "model", "PSNR, dB", "SSIM", "Frechet (floor; FID)", *(
        f"{what} by {_POSES.get(name, name)}" for name in judges for what in ("shift, mm", "turn, deg")
    )):  # fmt: skip
        first.add_column(column)
    second = Shown(title=f"{table.split.replace('_', ' ')}: {' / '.join(REGIONS.values())}")
    for column in ("transfer", "model", *(_heading(n, FIGURES[n]) for n in _REGIONAL), "kernel (floor)", "ms a touch"):
        second.add_column(column)
    for row in table.rows:
        first.add_row(*_first(row, judges))
        if row.figures:
            second.add_row(*_second(row))
    console.print(first)
    console.print(second)
    for note in table.notes:
        print_line(f"note: {note}")


_REGIONAL = ("error_mm", "iou", "correlation", "ssim_exact", "psnr_exact_db")


def _heading(name: str, metric: Metric) -> str:
    words = {"error_mm": "error", "iou": "contact IoU", "correlation": "correlation less the mean"}
    words |= {"ssim_exact": "SSIM, no noise", "psnr_exact_db": "PSNR, no noise"}
    return f"{words[name]}, {metric.unit}" if metric.unit else words[name]


def _transfer(row: Row) -> str:
    target = sensor(row.target).title
    return f"{sensor(row.source).title} > {target}" if row.source and not _needs_none(row) else target


def _needs_none(row: Row) -> bool:
    return row.contender in ("untouched", "mean")


def _first(row: Row, judges: Sequence[str]) -> list[str]:
    paper = row.paper
    cells = [_transfer(row), f"{row.title} ({paper.model})" if paper and paper.model else row.title]
    for name, theirs, digits in (
        ("psnr_db", paper and paper.psnr_db, 2), ("ssim", paper and paper.ssim, 2)
    ):  # fmt: skip
        ours = row.figures.get(name, {}).get("all")
        told = "-" if ours is None else f"{ours:.{digits}f}"
        cells.append(f"{told} ({theirs:.2f})" if theirs else told)
    sets = "-" if row.sets is None else f"{row.sets.frechet:.2f} ({row.sets.frechet_floor:.2f})"
    cells.append(f"{sets[:-1]}; {paper.fid:.1f})" if row.sets and paper and paper.fid else sets)
    for judge in judges:
        found = row.poses.get(judge)
        cells.append(_spread(found and found.shift_mm, paper and paper.shift_mm))
        cells.append(_spread(found and found.turn_deg, paper and paper.turn_deg))
    return cells


def _spread(ours: Spread | None, theirs: Spread | None) -> str:
    told = "-" if ours is None else f"{ours[0]:.2f} ± {ours[1]:.2f}"
    return f"{told} ({theirs[0]:.2f} ± {theirs[1]:.2f})" if theirs else told


def _second(row: Row) -> list[str]:
    cells = [_transfer(row), row.title]
    for name in _REGIONAL:
        of = row.figures.get(name, {})
        cells.append(" / ".join(_number(of.get(region)) for region in REGIONS))
    cells.append("-" if row.sets is None else f"{row.sets.kernel:.3f} ({row.sets.kernel_floor:.3f})")
    return [*cells, f"{row.ms:.0f}" if row.ms else "-"]


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.1f}" if abs(value) >= 10 else f"{value:.2f}"


def _show_sweep(points: Sequence[Point]) -> None:
    shown = Shown("transfer", "model", "parameter", "ms a touch", "error in contact, mm", "SSIM, no noise")
    for point in points:
        error, alike = point.error_mm, point.row.figures.get("ssim_exact", {}).get("all")
        name = f"{point.parameter} {point.value:g}" if point.parameter else "as it comes"
        shown.add_row(
            _transfer(point.row), point.row.title, name, f"{point.row.ms:.0f}",
            "-" if error is None else f"{error:.3f}", "-" if alike is None else f"{alike:.4f}",
        )  # fmt: skip
    Console().print(shown)


def _as_json(table: Table, points: Sequence[Point], wanted: Wanted, about: Mapping[str, object]) -> dict[str, object]:
    return {
        "split": table.split, "notes": list(table.notes), "regions": dict(REGIONS),
        "figures": {name: asdict(metric) for name, metric in FIGURES.items()},
        "wanted": {"methods": dict(wanted.methods), "settings": list(wanted.settings)}, "machine": dict(about),
        "rows": [asdict(row) for row in table.rows],
        "sweep": [{"parameter": p.parameter, "value": p.value, "row": asdict(p.row)} for p in points],
    }  # fmt: skip
