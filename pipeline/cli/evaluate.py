"""`tactoscope evaluate`: the paper's tables, its figures beside ours, and run time against error."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path

from rich.console import Console
from rich.table import Table as Shown

from pipeline.base.cluster import connect_cluster
from pipeline.base.files import prepare_folder, prepare_folder_for, write_json
from pipeline.base.machine import describe_machine, format_machine
from pipeline.base.progress import Progress, SubProgress
from pipeline.cli.interrupts import InterruptibleProgress, interruptible_progress
from pipeline.cli.terminal import ProgressBar, create_progress_bar, print_line
from pipeline.evaluation.paper_tables import EvaluationRequest, EvaluationTable, evaluate_tables
from pipeline.evaluation.published_results import MeanStd
from pipeline.evaluation.recorded_touch import REGIONS
from pipeline.evaluation.table_rows import TableRow
from pipeline.evaluation.time_error_sweep import SweepPoint, check_sweep_parameters, draw_sweep_plots, sweep_parameters
from pipeline.evaluation.touch_metrics import TOUCH_METRICS
from pipeline.metrics.stage_metrics import Metric
from pipeline.sensors.spec import load_sensor

_POSES = {"signed_distances": "registration", "network": "network"}


class _Watched:
    """A bar that Ctrl-C ends between two steps."""

    def __init__(self, bar: ProgressBar, work: InterruptibleProgress) -> None:
        self._bar, self._work = bar, work

    def step(self, fraction: float, text: str) -> None:
        """Show, or end."""
        self._work.step(fraction, text)
        self._bar.step(fraction, text)


def run_evaluation(
    wanted: EvaluationRequest, json: Path | None, sweep: Sequence[str], plots: Path | None, scheduler: str
) -> int:
    """Score, here or on a scheduler's workers, print and write; returns the exit code."""
    check_sweep_parameters(sweep)
    if json is not None:
        prepare_folder_for(json)
    if plots is not None:
        prepare_folder(plots)
    about = describe_machine()
    points: list[SweepPoint] = []
    with ExitStack() as open_now:
        work, bar = open_now.enter_context(interruptible_progress()), open_now.enter_context(create_progress_bar())
        elsewhere = open_now.enter_context(connect_cluster(scheduler)).map if scheduler else None
        watched: Progress = _Watched(ProgressBar(bar), work)
        table = evaluate_tables(wanted, SubProgress(watched, 0.0, 0.5 if sweep else 1.0), elsewhere)
        if sweep:
            points = sweep_parameters(wanted, sweep, SubProgress(watched, 0.5, 0.5), elsewhere)
    _show(table)
    if sweep:
        _show_sweep(points)
    print_line(format_machine(about))
    if json is not None:
        write_json(json, _as_json(table, points, wanted, about), "the tables")
    for path in draw_sweep_plots(points, plots) if plots is not None and points else ():
        print_line(f"drawn: {path}")
    return 0


def _show(table: EvaluationTable) -> None:
    console, judges = Console(width=200), list(dict.fromkeys(name for row in table.rows for name in row.pose_errors))
    first = Shown(title=f"{table.split.replace('_', ' ')}: ours, simulated (the paper's, real)")
    for column in ("transfer", "model", "PSNR, dB", "SSIM", "Frechet (floor; FID)", *(
        f"{what} by {_POSES.get(name, name)}" for name in judges for what in ("shift, mm", "turn, deg")
    )):  # fmt: skip
        first.add_column(column)
    second = Shown(title=f"{table.split.replace('_', ' ')}: {' / '.join(REGIONS.values())}")
    for column in (
        "transfer",
        "model",
        *(_heading(n, TOUCH_METRICS[n]) for n in _REGIONAL),
        "kernel (floor)",
        "ms a touch",
    ):
        second.add_column(column)
    for row in table.rows:
        first.add_row(*_first(row, judges))
        if row.metrics:
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


def _transfer(row: TableRow) -> str:
    target = load_sensor(row.target).title
    return f"{load_sensor(row.source).title} > {target}" if row.source and not _needs_none(row) else target


def _needs_none(row: TableRow) -> bool:
    return row.candidate in ("untouched", "mean")


def _first(row: TableRow, judges: Sequence[str]) -> list[str]:
    paper = row.paper
    cells = [_transfer(row), f"{row.title} ({paper.model})" if paper and paper.model else row.title]
    for name, theirs, digits in (
        ("psnr_db", paper and paper.psnr_db, 2), ("ssim", paper and paper.ssim, 2)
    ):  # fmt: skip
        ours = row.metrics.get(name, {}).get("all")
        told = "-" if ours is None else f"{ours:.{digits}f}"
        cells.append(f"{told} ({theirs:.2f})" if theirs else told)
    sets = (
        "-" if row.set_distances is None else f"{row.set_distances.frechet:.2f} ({row.set_distances.frechet_floor:.2f})"
    )
    cells.append(f"{sets[:-1]}; {paper.fid:.1f})" if row.set_distances and paper and paper.fid else sets)
    for judge in judges:
        found = row.pose_errors.get(judge)
        cells.append(_spread(found and found.translation_mm, paper and paper.translation_mm))
        cells.append(_spread(found and found.rotation_deg, paper and paper.rotation_deg))
    return cells


def _spread(ours: MeanStd | None, theirs: MeanStd | None) -> str:
    told = "-" if ours is None else f"{ours[0]:.2f} ± {ours[1]:.2f}"
    return f"{told} ({theirs[0]:.2f} ± {theirs[1]:.2f})" if theirs else told


def _second(row: TableRow) -> list[str]:
    cells = [_transfer(row), row.title]
    for name in _REGIONAL:
        of = row.metrics.get(name, {})
        cells.append(" / ".join(_number(of.get(region)) for region in REGIONS))
    cells.append(
        "-" if row.set_distances is None else f"{row.set_distances.kernel:.3f} ({row.set_distances.kernel_floor:.3f})"
    )
    return [*cells, f"{row.ms:.0f}" if row.ms else "-"]


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.1f}" if abs(value) >= 10 else f"{value:.2f}"


def _show_sweep(points: Sequence[SweepPoint]) -> None:
    shown = Shown("transfer", "model", "parameter", "ms a touch", "error in contact, mm", "SSIM, no noise")
    for point in points:
        error, alike = point.contact_error_mm, point.row.metrics.get("ssim_exact", {}).get("all")
        name = f"{point.parameter} {point.value:g}" if point.parameter else "as it comes"
        shown.add_row(
            _transfer(point.row), point.row.title, name, f"{point.row.ms:.0f}",
            "-" if error is None else f"{error:.3f}", "-" if alike is None else f"{alike:.4f}",
        )  # fmt: skip
    Console().print(shown)


def _as_json(
    table: EvaluationTable, points: Sequence[SweepPoint], wanted: EvaluationRequest, about: Mapping[str, object]
) -> dict[str, object]:
    return {
        "split": table.split, "notes": list(table.notes), "regions": dict(REGIONS),
        "figures": {name: asdict(metric) for name, metric in TOUCH_METRICS.items()},
        "wanted": {"methods": dict(wanted.methods), "settings": list(wanted.settings)}, "machine": dict(about),
        "rows": [asdict(row) for row in table.rows],
        "sweep": [{"parameter": p.parameter, "value": p.value, "row": asdict(p.row)} for p in points],
    }  # fmt: skip
