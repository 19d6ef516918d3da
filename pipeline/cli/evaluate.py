"""`tactoscope evaluate`: the paper's tables, its results next to ours."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from datetime import date
from functools import reduce
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from pipeline.cli.terminal import open_progress_bar, print_line, print_table
from pipeline.cli.translation_options import StageSettings, split_list
from pipeline.core.errors import SettingProblem
from pipeline.core.files import check_folder, check_folder_for, write_json
from pipeline.core.machine import describe_machine, format_machine
from pipeline.lab.evaluation.held_out import BASELINES, HeldOutOptions, find_trained_hold_out
from pipeline.lab.evaluation.paper_figures import draw_paper_figures
from pipeline.lab.evaluation.paper_tables import (
    POSE_METHODS,
    EvaluationRequest,
    EvaluationTable,
    evaluate_tables,
    parse_direction,
)
from pipeline.lab.evaluation.published_results import MeanStd
from pipeline.lab.evaluation.table_rows import TableRow
from pipeline.lab.evaluation.touch_metrics import REGIONS, TOUCH_METRICS
from pipeline.lab.evaluation.touch_scoring import INCEPTION, PAPER_GRASP
from pipeline.lab.training.recorded_pairs import PairFolder
from pipeline.sensors.spec import load_sensor
from pipeline.translation.catalogue import BUILT_IN, with_method

_POSE_TITLES = {
    "signed_distances": "registration",
    "network": "network",
    PAPER_GRASP: "the paper's protocol",
}
_FIRST_COLUMNS = ("transfer", "model", "PSNR, dB", "SSIM", "Frechet (floor; FID)")
_POSE_COLUMNS = ("translation, mm", "rotation, deg")
_WIDTH = 200  # of a table, letters
_REGION_METRICS = {  # columns of the second table, each with a value per region
    "error_mm": "error, mm",
    "iou": "contact IoU",
    "correlation": "correlation less the mean",
    "ssim_exact": "SSIM, no noise",
    "psnr_exact_db": "PSNR, no noise, dB",
}


def evaluate(
    *,
    split: Literal["unseen_grasps", "unseen_tools"],
    recordings: Path | None = None,
    hold_out: str | None = None,
    weights: Annotated[tuple[str, ...], Parameter(negative="")] = (),
    json: Path | None = None,
    grasps: int = 5,
    seed: int = 0,
    vary: float = 1.0,
    directions: Annotated[tuple[str, ...], Parameter(name="--direction", negative="")] = (),
    only: Annotated[tuple[str, ...], Parameter(negative="")] = (),
    stage_methods: Annotated[tuple[str, ...], Parameter(name="--method", negative="")] = (),
    settings: StageSettings = (),
    inception: Path | None = None,
    poses: str = "signed_distances,network",
    figures: Path | None = None,
    folder: Path | None = None,
) -> int:
    """Evaluate all candidates, print the tables and write them.

    Args:
        split: Test split: new grasps of training objects, or objects that no method was trained on.
        recordings: Recorded pairs of both sensors in place of simulated touches: a file or folder,
            as for `train --pairs`.
        hold_out: Pairs to score, as for `train --hold-out`; default: those that the training of the
            weights held out.
        weights: `method=FILE`, repeatable: weights of a touch method, or of a stage such as
            `depth`.
        json: File for all metrics of all rows.
        grasps: Touches per object.
        seed: Seed of the simulated touches; every seed gives other poses and sensor instances.
        vary: Variation between source sensor instances, 1 = as measured between real ones.
        directions: `source:target`, repeatable; default: the paper's four, as far as they are
            recorded.
        only: `recorded`, `own`, `no_contact`, `mean` or a touch method, repeatable; default: all.
        stage_methods: `stage=method` of the other stages in place of the route's own, such as
            `depth=network`.
        settings: `stage.parameter=value`, repeatable; a touch parameter applies to the methods that
            have it.
        inception: Weights of Inception v3 in torchvision's layout, such as
            `inception_v3_google-0cc3c7bd.pth`, whose features give the Frechet distance (FID) in
            place of our own encoder's.
        poses: Pose methods to judge touches by, comma-separated; `none` leaves poses out.
            `paper_grasp` is the paper's released protocol: both fingers of a recorded grasp
            together.
        figures: Folder for the paper's figures 4 and 5 of this split: touches by T2T and T2D2 next
            to the recorded ones.
        folder: Folder of the simulated touches; default: the user's cache.
    """
    chosen = reduce(with_method, stage_methods, dict[str, str]())
    files = parse_weights(weights)
    trained = (
        find_trained_hold_out(files) if recordings is not None and hold_out is None else hold_out
    )
    if inception is not None:
        files[INCEPTION] = inception
    # recorded pairs are always compared with the untouched image, mean and physics
    if only and recordings is not None:
        only = tuple(dict.fromkeys((*only, *BASELINES, "physics")))
    judges = () if poses == "none" else split_list(poses)
    request = EvaluationRequest(
        split=split,
        held_out=HeldOutOptions(grasps=grasps, seed=seed, sensor_variation=vary, folder=folder),
        directions=tuple(parse_direction(text) for text in directions),
        candidates=only,
        methods=chosen,
        settings=settings,
        weights=files,
        pairs=PairFolder(path=os.fspath(recordings) if recordings else "", hold_out=trained or ""),
        pose_methods=tuple(name for name in judges if name in POSE_METHODS or name != "network"),
    )
    if json is not None:
        check_folder_for(json)
    if figures is not None:
        check_folder(figures)
    machine = describe_machine()
    drawn: list[Path] = []
    with open_progress_bar() as progress:
        table = evaluate_tables(request, progress)
        if figures is not None:
            drawn = draw_paper_figures(request, figures, progress)
    _print_tables(table, is_recorded=recordings is not None)
    print_line(format_machine(machine))
    if json is not None:
        write_json(json, _as_json(table, request, machine), "the tables")
    for path in drawn:
        print_line(f"figure written: {path}")
    return 0


def parse_weights(assignments: Sequence[str]) -> dict[str, Path]:
    """Touch method or stage -> file of `name=FILE`; raises SettingProblem."""
    known = {
        *(m.name for m in BUILT_IN.stage("touch").methods),
        *(stage.name for stage in BUILT_IN.stages),
    }
    files: dict[str, Path] = {}
    for assignment in assignments:
        name, equals, file = (part.strip() for part in assignment.partition("="))
        if not equals or name not in known:
            raise SettingProblem(
                f"weights are given by method=FILE, got {assignment!r}; names are "
                f"{', '.join(sorted(known))}"
            )
        files[name] = Path(file)
    return files


def _print_tables(table: EvaluationTable, *, is_recorded: bool) -> None:
    judges = list(dict.fromkeys(name for row in table.rows for name in row.pose_errors))
    titles = [_POSE_TITLES.get(name, name) for name in judges]
    split = table.split.replace("_", " ")
    print_table(
        (
            *_FIRST_COLUMNS,
            *(f"{what} by {title}" for title in titles for what in _POSE_COLUMNS),
        ),
        (_paper_cells(row, judges) for row in table.rows),
        title=f"{split}: ours, {'recorded' if is_recorded else 'simulated'} [95 % interval] (the "
        "paper's)",
        width=_WIDTH,
    )
    print_table(
        ("transfer", "model", *_REGION_METRICS.values(), "kernel", "ms a touch"),
        (_region_cells(row) for row in table.rows if row.metrics),
        title=f"{split}: {' / '.join(REGIONS.values())}",
        width=_WIDTH,
    )
    for note in table.notes:
        print_line(f"note: {note}")


def _format_transfer(row: TableRow) -> str:
    target = load_sensor(row.target).title
    if not row.source or row.candidate in BASELINES:
        return target
    return f"{load_sensor(row.source).title} > {target}"


def _paper_cells(row: TableRow, judges: Sequence[str]) -> list[str]:
    paper = row.paper
    sets = row.set_distances
    cells = [
        _format_transfer(row),
        f"{row.title} ({paper.model})" if paper and paper.model else row.title,
    ]
    for name, published in (("psnr_db", paper and paper.psnr_db), ("ssim", paper and paper.ssim)):
        ours = row.metrics.get(name, {}).get("all")
        text = "-" if ours is None else f"{ours:.2f}{_format_interval(row, name)}"
        cells.append(f"{text} ({published:.2f})" if published else text)
    fid = f"; {paper.fid:.1f}" if paper and paper.fid else ""
    cells.append("-" if sets is None else f"{sets.frechet:.2f} ({sets.frechet_floor:.2f}{fid})")
    for judge in judges:
        ours = row.pose_errors.get(judge)
        for name in ("translation_mm", "rotation_deg"):
            text = "-" if ours is None else _format_spread(getattr(ours, name))
            cells.append(f"{text} ({_format_spread(getattr(paper, name))})" if paper else text)
    return cells


def _format_spread(spread: MeanStd) -> str:
    return f"{spread[0]:.2f} ± {spread[1]:.2f}"


def _region_cells(row: TableRow) -> list[str]:
    cells = [_format_transfer(row), row.title]
    for name in _REGION_METRICS:
        known = row.metrics.get(name, {})
        values = " / ".join(_format_number(known.get(region)) for region in REGIONS)
        cells.append(values + _format_interval(row, name))
    sets = row.set_distances
    cells.append("-" if sets is None else f"{sets.kernel:.4f}")
    return [*cells, f"{row.ms:.0f}" if row.ms else "-"]


def _format_interval(row: TableRow, metric: str) -> str:
    """The 95 % interval of a metric over the image, with a leading space; "" where unknown."""
    interval = row.intervals.get(metric, {}).get("all")
    return f" [{', '.join(map(_format_number, interval))}]" if interval else ""


def _format_number(value: float | None) -> str:
    return "-" if value is None else f"{value:.1f}" if abs(value) >= 10 else f"{value:.2f}"


def _as_json(
    table: EvaluationTable,
    request: EvaluationRequest,
    machine: Mapping[str, object],
) -> dict[str, object]:
    return {
        "split": table.split,
        "date": date.today().isoformat(),
        "notes": list(table.notes),
        "regions": dict(REGIONS),
        "metrics": {name: asdict(metric) for name, metric in TOUCH_METRICS.items()},
        "request": {"methods": dict(request.methods), "settings": list(request.settings)},
        "machine": dict(machine),
        "rows": [asdict(row) for row in table.rows],
    }
