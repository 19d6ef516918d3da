"""The options of `tactoscope evaluate`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from pipeline.cli.translation_options import StageSettings, split_list


def evaluate(
    *,
    split: Literal["unseen_grasps", "unseen_tools"],
    json: Path | None = None,
    grasps: int = 5,
    vary: float = 1.0,
    directions: Annotated[tuple[str, ...], Parameter(name="--direction", negative="")] = (),
    only: Annotated[tuple[str, ...], Parameter(negative="")] = (),
    fill: Annotated[tuple[str, ...], Parameter(name="--method", negative="")] = (),
    settings: StageSettings = (),
    poses: str = "signed_distances,network",
    sweep: str = "",
    plots: Path | None = None,
    folder: Path | None = None,
    scheduler: str = "",
) -> int:
    """Score every way to a touch as the paper's two tables do, its figures beside ours.

    The touches are simulated, the paper's are real: the figures show what is hard, not who is better. Every touch
    method that has weights for a direction takes part, beside the untouched picture and the mean of other touches.

    Parameters
    ----------
    split
        Training objects as they were never held, or tools that nothing was taught on.
    json
        File for all figures of all rows.
    grasps
        Touches of each object.
    vary
        How far the source units differ from the described ones, 1 = as those of a lab.
    directions
        `source:target`, as often as needed; the paper's four if none is given.
    only
        `recorded`, `untouched`, `mean` or a touch method, as often as needed; all if none is given.
    fill
        `slot=method` of the other slots in place of the route's own, such as `depth=network`.
    settings
        `slot.parameter=value`, as often as needed; one of the touch is for the methods that have it.
    poses
        Pose methods that touches are judged by, with commas; `none` leaves poses out.
    sweep
        `steps`, `guidance` or both with a comma: run time against error at many values.
    plots
        Folder for a picture of each direction's sweep.
    folder
        Where the simulated touches are kept; the user's cache if not given.
    scheduler
        Address of a Dask scheduler whose workers score the recordings, such as `tcp://host:8786`.
    """
    from pipeline.cli.evaluate import run_evaluation as score
    from pipeline.evaluation.held_out import HeldOutOptions
    from pipeline.evaluation.paper_tables import POSE_METHODS, EvaluationRequest, parse_direction
    from pipeline.evaluation.published_results import PAPER_DIRECTIONS
    from pipeline.translation.catalogue import with_method

    chosen: dict[str, str] = {}
    for assignment in fill:
        chosen = with_method(chosen, assignment)
    judges = (
        ()
        if poses == "none"
        else tuple(name for name in split_list(poses) if name in POSE_METHODS or name != "network")
    )
    wanted = EvaluationRequest(
        split=split, held_out=HeldOutOptions(grasps=grasps, sensor_variation=vary, folder=folder),
        directions=tuple(parse_direction(text) for text in directions) or PAPER_DIRECTIONS, candidates=only, methods=chosen,
        settings=settings, pose_methods=judges,
    )  # fmt: skip
    return score(wanted, json, split_list(sweep), plots, scheduler)
