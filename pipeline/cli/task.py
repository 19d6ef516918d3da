"""`tactoscope task`: closed-loop tasks through every touch, as success rates with intervals."""

import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from pipeline.cli.terminal import open_progress_bar, print_line, print_table
from pipeline.cli.translation_options import Flag, split_list
from pipeline.core.files import check_folder, check_folder_for, write_json
from pipeline.lab.tasks.rerun import copy_case
from pipeline.lab.tasks.rollout_file import CASE_SUFFIX
from pipeline.lab.tasks.runner import Summary, make_jobs, run_jobs
from pipeline.lab.tasks.task import ManipulationTask, load_task, parse_disturbance


def task(
    name: Annotated[
        str,
        Parameter(help="`insertion`, `stack`, `marble`, or a TOML file of a tool for insertion."),
    ],
    *,
    trials: int = 0,
    touch: str = "",
    case: str = "",
    tolerance_mm: str = "",
    seed: int = 0,
    vary: float = 1.0,
    attribute: Flag = False,
    disturb: str = "",
    jobs: int = 2,
    json: Path | None = None,
    record: Path | None = None,
) -> int:
    """Run the trials and print successes with 95 % intervals; the same seed gives the same bytes.

    Args:
        trials: Trials per case; default: as many as in the paper.
        touch: Touch methods, `true` (the target's own frame), `own` (the source's, not translated)
            and `none`, comma-separated, such as `object,own,true`.
        case: Objects, comma-separated; default: all of the task.
        tolerance_mm: Clearances or tolerances in mm, comma-separated, such as `0.5,1`.
        seed: Seed of starts, sensor instances and noise.
        vary: Variation between sensor instances, 1 = as between real ones.
        attribute: Attribute the error of every failed trial to stages, and run it again with the
            truth in place of each.
        disturb: What goes wrong with the grasp, such as `slip=1,tilt=3,alignment=1`: mm that the
            object slips after the touch, degrees that it is tilted out of the fingers' plane, mm
            (and twice as many degrees) that the source sensor is off its described place.
        jobs: Number of processes.
        json: File for every trial with its decisions.
        record: Folder for one recording per rollout; the same command continues an interrupted run.
    """
    disturbance = parse_disturbance(split_list(disturb))
    planned = make_jobs(
        name,
        cases=split_list(case),
        touches=split_list(touch),
        tolerances_mm=[_parse_mm(text) for text in split_list(tolerance_mm)],
        n_trials=trials,
        seed=seed,
        vary=vary,
        attribute=attribute,
        disturbance=disturbance,
        folder=None if record is None else record.resolve(),
    )
    if json is not None:
        check_folder_for(json)
    if record is not None:
        check_folder(record)
        if name.endswith(CASE_SUFFIX):
            copy_case(Path(name), record)
    chosen = load_task(planned[0].plan.task)
    with open_progress_bar() as progress:
        summaries = run_jobs(planned, jobs, progress)
    _print_table(chosen, summaries)
    if json is not None:
        write_json(
            json,
            {
                "task": chosen.name,
                "seed": seed,
                "vary": vary,
                "disturbance": asdict(disturbance),
                "rollouts": summaries,
            },
            "the rollouts",
        )
    return 0


def _parse_mm(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


def _print_table(chosen: ManipulationTask, summaries: Sequence[Summary]) -> None:
    from scipy.stats import binomtest

    touches, tolerances, cases = (
        list(dict.fromkeys(one[key] for one in summaries))
        for key in ("touch", "tolerance_mm", "case")
    )
    rows: list[list[str]] = []
    for case in [*cases, *(["all"] if len(cases) > 1 else [])]:
        for tolerance in tolerances:
            row = [case, f"{tolerance:g}"]
            for touch in touches:
                outcomes = [
                    one["succeeds"]
                    for one in summaries
                    if (one["touch"], one["tolerance_mm"]) == (touch, tolerance)
                    and case in (one["case"], "all")
                ]
                low, high = binomtest(sum(outcomes), len(outcomes)).proportion_ci(method="wilson")
                text = f"{sum(outcomes)}/{len(outcomes)} ({low:.0%}-{high:.0%})"
                row.append("; ".join((text, *filter(None, [chosen.published.get((case, touch))]))))
            rows.append(row)
    title = f"{chosen.title}: successes (95 %); the paper's"
    print_table(("case", chosen.tolerance_title, *touches), rows, title=title, width=200)
    for one in [one for one in summaries if not one["succeeds"] and one["decisions"][0]["shares"]]:
        print_line(
            f"{one['case']} {one['trial']} by {one['touch']} at {one['tolerance_mm']:g} mm: "
            f"{one['cause']}"
        )
