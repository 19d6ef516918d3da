"""The paper's tables: every direction and candidate on one split of held-out touches."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from pipeline.base.errors import SettingProblem
from pipeline.base.params import list_settings
from pipeline.base.progress import SILENT, Progress, SubProgress
from pipeline.evaluation import touch_features
from pipeline.evaluation.candidates import BASELINES, RECORDED, select_candidates
from pipeline.evaluation.held_out import HeldOutOptions, load_or_simulate, select_sensors
from pipeline.evaluation.published_results import COMPARISON_NOTE, PAPER_DIRECTIONS, Split
from pipeline.evaluation.table_rows import TableRow, build_rows
from pipeline.evaluation.touch_scoring import ScoredTouch, ScoringJob, score_recording
from pipeline.networks.weights import NoWeights, Weights
from pipeline.sensors.spec import SensorSpec, load_sensor
from pipeline.translation.catalogue import BUILT_IN

JobMapper = Callable[[Callable[..., Any], Sequence[ScoringJob], Progress], Sequence[list[ScoredTouch]]]
MEAN_TOUCH_GRASPS = 3  # per training object, for the mean touch
POSE_METHODS = tuple(m.name for m in BUILT_IN.stage("pose").methods if m.name in ("signed_distances", "network"))


@dataclass(frozen=True, slots=True, kw_only=True)
class EvaluationRequest:
    """Split, directions, candidates and settings of an evaluation."""

    split: Split
    held_out: HeldOutOptions = field(default_factory=HeldOutOptions)
    directions: tuple[tuple[str, str], ...] = PAPER_DIRECTIONS
    candidates: tuple[str, ...] = ()  # () = all
    methods: Mapping[str, str] = field(default_factory=dict)
    settings: tuple[str, ...] = ()
    pose_methods: tuple[str, ...] = POSE_METHODS


@dataclass(frozen=True, slots=True, kw_only=True)
class EvaluationTable:
    """Rows of an evaluation, with notes on their conditions."""

    split: Split
    rows: tuple[TableRow, ...]
    notes: tuple[str, ...]


def evaluate_tables(
    request: EvaluationRequest, progress: Progress = SILENT, work: JobMapper | None = None
) -> EvaluationTable:
    """Score all touches and build the rows; `work` maps jobs to other processes or machines, None runs them here.

    Raises SettingProblem for an unknown direction, method or candidate, and the errors of methods.
    """
    _check_settings(request)
    candidate_sets = [
        select_candidates(load_sensor(source), load_sensor(target), request.candidates)
        for source, target in request.directions
    ]
    sensor_sets = dict.fromkeys(select_sensors(*direction) for direction in request.directions)
    recordings = {
        sensors: load_or_simulate(
            request.split,
            request.held_out,
            SubProgress(progress, 0.1 * k / len(sensor_sets), 0.1 / len(sensor_sets)),
            sensors,
        )
        for k, sensors in enumerate(sensor_sets)
    }
    training = load_or_simulate(
        "training",
        replace(request.held_out, grasps=MEAN_TOUCH_GRASPS, sensor_variation=0.0),
        SubProgress(progress, 0.1, 0.05),
    )
    rows: list[TableRow] = []
    notes: list[str] = [COMPARISON_NOTE]
    whole = SubProgress(progress, 0.15, 0.85)
    for index, ((source, target), candidate_set) in enumerate(zip(request.directions, candidate_sets, strict=True)):
        part = SubProgress(
            whole, index / len(request.directions), 1.0 / len(request.directions), f"{source} to {target}"
        )
        pose_methods, missing = _select_pose_methods(request.pose_methods, load_sensor(source), load_sensor(target))
        notes += [*candidate_set.excluded, *missing]
        jobs = [
            ScoringJob(
                recordings=one,
                source=source,
                target=target,
                candidates=candidate_set.candidates,
                training_recordings=tuple(u.target for u in training),
                methods=request.methods,
                settings=request.settings,
                pose_methods=pose_methods,
            )
            for one in recordings[select_sensors(source, target)]
        ]
        scored = _run_jobs(jobs, part) if work is None else work(score_recording, jobs, part)
        rows += build_rows(
            request.split, source, target, candidate_set.candidates, [touch for job in scored for touch in job]
        )
    return EvaluationTable(
        split=request.split,
        rows=tuple(_remove_duplicates(rows)),
        notes=(*_describe_conditions(request), *dict.fromkeys(notes)),
    )


def _select_pose_methods(
    names: Sequence[str], source: SensorSpec, target: SensorSpec
) -> tuple[tuple[str, ...], list[str]]:
    """Pose methods that can judge touches of this target, and why others cannot."""
    methods: list[str] = []
    missing: list[str] = []
    for name in names:
        method = BUILT_IN.method("pose", name)
        known = None if method.weights is None else method.weights(source, target, None)
        if isinstance(known, NoWeights):
            missing.append(f"no poses by {name} for {target.name}: {known.why}")
        else:
            methods.append(name)
    return tuple(methods), missing


def _check_settings(request: EvaluationRequest) -> None:
    """Raise SettingProblem for a touch setting that no method has."""
    known = {name for method in BUILT_IN.stage("touch").methods for name in list_settings(method.params())}
    for assignment in request.settings:
        stage, _, name = assignment.partition("=")[0].strip().partition(".")
        if stage == "touch" and name not in known:
            raise SettingProblem(f"no touch method has a parameter {name!r}; there are {', '.join(sorted(known))}")


def _run_jobs(jobs: Sequence[ScoringJob], progress: Progress) -> list[list[ScoredTouch]]:
    return [score_recording(job, SubProgress(progress, k / len(jobs), 1.0 / len(jobs))) for k, job in enumerate(jobs)]


def _remove_duplicates(rows: Sequence[TableRow]) -> list[TableRow]:
    """Keep recorded touches and baselines once per target."""
    unique: dict[tuple[str, ...], TableRow] = {}
    for row in rows:
        has_source = row.candidate not in (RECORDED, *BASELINES)
        unique.setdefault((row.source if has_source else "", row.target, row.candidate), row)
    return list(unique.values())


def _describe_conditions(request: EvaluationRequest) -> list[str]:
    """Notes on the conditions of the evaluation."""
    notes = [
        f"{request.split.replace('_', ' ')}: {request.held_out.grasps} grasps of each object; source sensor "
        f"instances vary by {request.held_out.sensor_variation:g}, targets are as described"
    ]
    for target in dict.fromkeys(target for _, target in request.directions):
        encoder = touch_features.load_encoder_weights(load_sensor(target))
        if isinstance(encoder, Weights):
            notes.append(f"encoder of {target}: {encoder.name}, {encoder.content_digest[:12]}")
        else:
            notes.append(f"no Frechet or kernel distance for {target}: {encoder.why}")
    return notes


def parse_direction(text: str) -> tuple[str, str]:
    """Source and target of `source:target`; raises SettingProblem unless both are known sensors."""
    source, arrow, target = (part.strip() for part in text.partition(":"))
    if not arrow or not source or not target:
        raise SettingProblem(f"a direction is written source:target, as gelslim:soft_bubble; got {text!r}")
    return load_sensor(source).name, load_sensor(target).name
