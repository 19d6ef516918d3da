"""The paper's tables: every direction and candidate on one split of held-out touches."""

from collections.abc import Mapping, Sequence
from dataclasses import field, replace
from pathlib import Path

from pipeline.core.errors import SettingProblem
from pipeline.core.frozen import frozen
from pipeline.core.params import list_settings
from pipeline.core.progress import SILENT, Progress, SubProgress
from pipeline.lab.evaluation.held_out import (
    BASELINES,
    RECORDED,
    HeldOutOptions,
    PressRecordings,
    check_candidate_names,
    load_or_simulate,
    open_directions,
    require_touches,
    select_candidates,
    select_recorded,
    select_sensors,
)
from pipeline.lab.evaluation.published_results import COMPARISON_NOTE, PAPER_DIRECTIONS, Split
from pipeline.lab.evaluation.table_rows import TableRow, build_rows
from pipeline.lab.evaluation.touch_scoring import (
    INCEPTION,
    PAPER_GRASP,
    ScoringJob,
    load_encoder_weights,
    score_recording,
)
from pipeline.lab.training.recorded_pairs import PairFolder
from pipeline.sensors.spec import SensorSpec, load_sensor
from pipeline.stages.networks.weights import NoWeights, Weights
from pipeline.translation.catalogue import BUILT_IN

DirectionTouches = dict[
    tuple[str, str], tuple[tuple[PressRecordings, ...], tuple[PressRecordings, ...]]
]
REAL_NOTE = (
    "touches are recorded pairs; where a target's truth is not recorded, its contact and "
    "indentation are estimated "
    "from its own frame; a Frechet distance uses our own encoder, trained on simulated touches"
)
MEAN_TOUCH_GRASPS = 3  # per training object, for the mean touch
POSE_METHODS = tuple(
    m.name for m in BUILT_IN.stage("pose").methods if m.name in ("signed_distances", "network")
)


@frozen
class EvaluationRequest:
    """Split, directions, candidates and settings of an evaluation."""

    split: Split
    held_out: HeldOutOptions = field(default_factory=HeldOutOptions)
    directions: tuple[tuple[str, str], ...] = ()  # () = the paper's, as far as they are recorded
    candidates: tuple[str, ...] = ()  # () = all
    methods: Mapping[str, str] = field(default_factory=dict)
    settings: tuple[str, ...] = ()
    pose_methods: tuple[str, ...] = POSE_METHODS
    # touch method, stage or `INCEPTION` -> file
    weights: Mapping[str, Path] = field(default_factory=dict)
    # recorded pairs in place of simulated touches
    pairs: PairFolder = field(default_factory=PairFolder)


@frozen
class EvaluationTable:
    """Rows of an evaluation, with notes on their conditions."""

    split: Split
    rows: tuple[TableRow, ...]
    notes: tuple[str, ...]


def evaluate_tables(request: EvaluationRequest, progress: Progress = SILENT) -> EvaluationTable:
    """Score all touches and build the rows.

    Raises SettingProblem for an unknown direction, method or candidate, and the errors of methods.
    """
    _check_settings(request)
    touches, notes = collect_touches(request, SubProgress(progress, 0.0, 0.15))
    candidate_sets = [
        select_candidates(
            load_sensor(source), load_sensor(target), request.candidates, request.weights
        )
        for source, target in touches
    ]
    for method in set(request.weights).intersection(request.candidates or request.weights):
        whys = [one.excluded[method] for one in candidate_sets if method in one.excluded]
        # a file of one direction leaves the method out of the others
        if len(whys) == len(candidate_sets):
            raise SettingProblem(f"--weights {method}={request.weights[method]}: {whys[0]}")
    rows: list[TableRow] = []
    whole = SubProgress(progress, 0.15, 0.85)
    for index, ((source, target), candidate_set) in enumerate(
        zip(touches, candidate_sets, strict=True)
    ):
        part = SubProgress(whole, index / len(touches), 1.0 / len(touches), f"{source} to {target}")
        held_out, training = touches[source, target]
        pose_methods, missing = _select_pose_methods(
            request.pose_methods, load_sensor(source), load_sensor(target)
        )
        notes += [*candidate_set.excluded.values(), *missing]
        jobs = [
            ScoringJob(
                recordings=one,
                source=source,
                target=target,
                candidates=candidate_set.candidates,
                training_recordings=training,
                weights=request.weights,
                methods=request.methods,
                settings=request.settings,
                pose_methods=pose_methods,
            )
            for one in held_out
        ]
        n = len(jobs)
        scored = [
            touch
            for k, job in enumerate(jobs)
            for touch in score_recording(job, SubProgress(part, k / n, 1.0 / n))
        ]
        rows += build_rows(request.split, source, target, candidate_set.candidates, scored)
    return EvaluationTable(
        split=request.split,
        rows=tuple(_remove_duplicates(rows)),
        notes=(*_describe_conditions(request, touches), *dict.fromkeys(notes)),
    )


def collect_touches(
    request: EvaluationRequest, progress: Progress
) -> tuple[DirectionTouches, list[str]]:
    """Direction -> (touches to score, touches of the mean touch), simulated once if need be.

    And notes on them.
    """
    if request.pairs.path:
        opened = open_directions(request.pairs, request.directions)
        for pairs in opened.values():
            require_touches(pairs, request.split)
        notes = [REAL_NOTE, *(note for pairs in opened.values() for note in pairs.notes)]
        sets = {
            d: (select_recorded(p, request.split), select_recorded(p, "training"))
            for d, p in opened.items()
        }
        return sets, notes
    directions = request.directions or PAPER_DIRECTIONS
    sensor_sets = dict.fromkeys(select_sensors(*direction) for direction in directions)
    recordings = {
        sensors: load_or_simulate(
            request.split,
            request.held_out,
            SubProgress(progress, 0.67 * k / len(sensor_sets), 0.67 / len(sensor_sets)),
            sensors,
        )
        for k, sensors in enumerate(sensor_sets)
    }
    training = load_or_simulate(
        "training",
        replace(request.held_out, grasps=MEAN_TOUCH_GRASPS, sensor_variation=0.0, seed=0),
        SubProgress(progress, 0.67, 0.33),
    )
    return {d: (recordings[select_sensors(*d)], training) for d in directions}, [COMPARISON_NOTE]


def _select_pose_methods(
    names: Sequence[str], source: SensorSpec, target: SensorSpec
) -> tuple[tuple[str, ...], list[str]]:
    """Pose methods that can judge touches of this target, and why others cannot."""
    methods: list[str] = []
    missing: list[str] = []
    for name in names:
        select = None if name == PAPER_GRASP else BUILT_IN.method("pose", name).weights
        known = select and select(source, target, None)
        if isinstance(known, NoWeights):
            missing.append(f"no poses by {name} for {target.name}: {known.why}")
        else:
            methods.append(name)
    return tuple(methods), missing


def _check_settings(request: EvaluationRequest) -> None:
    """Raise SettingProblem for an unknown candidate, a touch method for all, or a setting that
    no touch method has.
    """
    check_candidate_names(request.candidates)
    if INCEPTION in request.weights:
        known = load_encoder_weights(load_sensor("gelslim"), request.weights)
        if isinstance(known, NoWeights):
            raise SettingProblem(f"--inception: {known.why}")
    if "touch" in request.methods:
        raise SettingProblem(
            "every touch method is evaluated; name those of interest with --only, not with --method"
        )
    known = {
        name
        for method in BUILT_IN.stage("touch").methods
        for name in list_settings(method.params())
    }
    for assignment in request.settings:
        stage, _, name = assignment.partition("=")[0].strip().partition(".")
        if stage == "touch" and name not in known:
            raise SettingProblem(
                f"no touch method has a parameter {name!r}; there are {', '.join(sorted(known))}"
            )


def _remove_duplicates(rows: Sequence[TableRow]) -> list[TableRow]:
    """Keep recorded touches and baselines once per target."""
    unique: dict[tuple[str, ...], TableRow] = {}
    for row in rows:
        has_source = row.candidate not in (RECORDED, *BASELINES)
        unique.setdefault((row.source if has_source else "", row.target, row.candidate), row)
    return list(unique.values())


def _describe_conditions(request: EvaluationRequest, touches: DirectionTouches) -> list[str]:
    """Notes on the conditions of the evaluation."""
    split = request.split.replace("_", " ")
    if request.pairs.path:
        found: list[str] = []
        for held_out, _ in touches.values():
            fingers = [r for r in held_out if r.source_stream == held_out[0].source_stream]
            n_grasps = sum(len(set(r.frame_names)) for r in fingers)
            n_pairs = sum(len(r.frames) for r in held_out)
            found.append(f"{split}: {n_pairs} pairs of {n_grasps} grasps in {request.pairs.path}")
        notes = list(dict.fromkeys(found))
    else:
        notes = [
            f"{split}: {request.held_out.grasps} grasps of each object; source sensor "
            f"instances vary by {request.held_out.sensor_variation:g}, targets are as described"
        ]
    for target in dict.fromkeys(target for _, target in touches):
        encoder = load_encoder_weights(load_sensor(target), request.weights)
        if isinstance(encoder, Weights):
            notes.append(f"encoder of {target}: {encoder.name}, {encoder.content_digest[:12]}")
        else:
            notes.append(f"no Frechet or kernel distance for {target}: {encoder.why}")
    return notes


def parse_direction(text: str) -> tuple[str, str]:
    """Source and target of `source:target`; raises SettingProblem unless both are known sensors."""
    source, arrow, target = (part.strip() for part in text.partition(":"))
    if not arrow or not source or not target:
        raise SettingProblem(
            f"a direction is written source:target, as gelslim:soft_bubble; got {text!r}"
        )
    direction = load_sensor(source).name, load_sensor(target).name
    if direction[0] == direction[1]:
        raise SettingProblem(f"a direction is between two sensors, got {text!r}")
    return direction
