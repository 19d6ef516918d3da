"""Background work of the *Task* layout: rows of a folder, one rollout with its scene, and its
attribution.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from app.window.jobs import JobReporter
from pipeline.core.arrays import Doubles
from pipeline.core.errors import FileProblem
from pipeline.core.frozen import frozen
from pipeline.lab.tasks.task import Decision, RecordedRollout
from pipeline.lab.tasks.trial_rows import TrialRow
from pipeline.views.layers import Layer, ViewBounds
from pipeline.views.view import StepCurve

_MOST_TRIED = 5  # files of a folder, of which one is a rollout where any is


@frozen
class TrialFolder:
    """The rollouts of a folder, and what the session needs to open each."""

    folder: Path
    trials: tuple[TrialRow, ...]
    choices: Mapping[Path, Mapping[str, Any]]  # fields of the session


@frozen
class OpenRollout:
    """One rollout, ready to be shown at any tick."""

    rollout: RecordedRollout
    layers: tuple[Layer, ...]
    bounds: ViewBounds
    poses: tuple[Mapping[str, Doubles], ...]  # world_from_layer of every tick by layer
    curves: tuple[StepCurve, ...]
    places: Mapping[str, str]  # stream of the source -> title of its finger
    error_title: str  # what the error of a decision measures
    unavailable: str = ""  # why there is no scene


def list_trial_folder(path: Path, report: JobReporter) -> TrialFolder:
    """List the rollouts of a folder, or of that of a file.

    Raises FileProblem where there is none.
    """
    from pipeline.lab.tasks.rollout_file import may_be_rollout
    from pipeline.lab.tasks.trial_rows import SUFFIXES, list_trials

    # a large folder of other recordings is not read through
    files = sorted(f for f in path.iterdir() if f.suffix in SUFFIXES) if path.is_dir() else [path]
    if not any(may_be_rollout(file) for file in files[:_MOST_TRIED]):
        raise FileProblem(
            "this is no rollout of a task; open a folder of recorded trials",
            path,
        )
    trials = list_trials(path, report)
    choices = {trial.path: _choose_fields(trial) for trial in trials if not trial.problem}
    return TrialFolder(
        folder=path if path.is_dir() else path.parent, trials=trials, choices=choices
    )


def _choose_fields(trial: TrialRow) -> Mapping[str, Any]:
    """The fields of the session that translate a rollout's frames as its controller did."""
    from pipeline.lab.tasks.task import load_task
    from pipeline.lab.tasks.touches import make_touch_request

    task = load_task(trial.task)
    asked = make_touch_request(trial.touch, trial.path, task.source, task.target)
    return {
        "source": asked.source,
        "target": asked.target,
        "route": asked.route,
        "methods": dict(asked.methods),
        "weights": dict(asked.weights),
    }


def open_rollout(path: Path, report: JobReporter) -> OpenRollout:
    """Read a rollout and build its scene; raises FileProblem."""
    from pipeline.lab.tasks.rollout_file import list_places, read_rollout
    from pipeline.lab.tasks.scene_view import (
        build_scene,
        compute_bounds,
        make_scene_layers,
        make_traces,
    )
    from pipeline.lab.tasks.task import load_task

    report.step(0.0, "reading the rollout")
    rollout = read_rollout(path)
    report.step(0.5, "building the scene")
    scene = build_scene(rollout)
    return OpenRollout(
        rollout=rollout,
        layers=make_scene_layers(scene),
        bounds=compute_bounds(scene),
        poses=tuple(scene.place(tick) for tick in range(rollout.n_ticks)),
        curves=make_traces(rollout),
        places=list_places(path),
        error_title="error" if scene.problem else load_task(rollout.plan.task).error_title,
        unavailable=scene.problem,
    )


def attribute_decisions(rollout: RecordedRollout, report: JobReporter) -> tuple[Decision, ...]:
    """Attribute the errors of a rollout by running it again; raises TouchError."""
    from pipeline.lab.tasks.rerun import attribute_rollout

    return attribute_rollout(rollout, report)
