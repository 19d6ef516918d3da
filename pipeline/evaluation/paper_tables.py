"""A whole table: every direction of the paper, every contender, on one split of held-out touches."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from pipeline.base.errors import SettingProblem
from pipeline.base.params import list_settings
from pipeline.base.progress import SILENT, Progress, SubProgress
from pipeline.evaluation import touch_features
from pipeline.evaluation.candidates import select_candidates
from pipeline.evaluation.held_out import HeldOutOptions, load_or_simulate, select_sensors
from pipeline.evaluation.published_results import COMPARISON_NOTE, PAPER_DIRECTIONS, Split
from pipeline.evaluation.table_rows import TableRow, build_rows
from pipeline.evaluation.touch_scoring import ScoredTouch, ScoringJob, score_recording
from pipeline.networks.weights import NoWeights, Weights
from pipeline.sensors.spec import SensorSpec, load_sensor
from pipeline.translation.catalogue import BUILT_IN

JobMapper = Callable[[Callable[..., Any], Sequence[ScoringJob], Progress], Sequence[list[ScoredTouch]]]
MEAN_TOUCH_GRASPS = 3  # of each training object: what the mean touch is taken of
POSE_METHODS = tuple(m.name for m in BUILT_IN.stage("pose").methods if m.name in ("signed_distances", "network"))


@dataclass(frozen=True, slots=True, kw_only=True)
class EvaluationRequest:
    """What to evaluate."""

    split: Split
    held_out: HeldOutOptions = field(default_factory=HeldOutOptions)
    directions: tuple[tuple[str, str], ...] = PAPER_DIRECTIONS
    candidates: tuple[str, ...] = ()  # () = all
    methods: Mapping[str, str] = field(default_factory=dict)
    settings: tuple[str, ...] = ()
    pose_methods: tuple[str, ...] = POSE_METHODS


@dataclass(frozen=True, slots=True, kw_only=True)
class EvaluationTable:
    """What came out."""

    split: Split
    rows: tuple[TableRow, ...]
    notes: tuple[str, ...]


def evaluate_tables(
    wanted: EvaluationRequest, progress: Progress = SILENT, work: JobMapper | None = None
) -> EvaluationTable:
    """Score and sum up; `work` maps the pieces elsewhere (other processes or machines), None does them here in turn.

    Raises SettingProblem for a direction, method or contender that does not exist, and what a method raises.
    """
    _check_settings(wanted)
    fields = [
        select_candidates(load_sensor(source), load_sensor(target), wanted.candidates)
        for source, target in wanted.directions
    ]
    asked = dict.fromkeys(select_sensors(*direction) for direction in wanted.directions)
    pressed = {
        sensors: load_or_simulate(
            wanted.split, wanted.held_out, SubProgress(progress, 0.1 * k / len(asked), 0.1 / len(asked)), sensors
        )
        for k, sensors in enumerate(asked)
    }
    usual = load_or_simulate(
        "usual", replace(wanted.held_out, grasps=MEAN_TOUCH_GRASPS, vary=0.0), SubProgress(progress, 0.1, 0.05)
    )
    found: list[TableRow] = []
    notes: list[str] = [COMPARISON_NOTE]
    whole = SubProgress(progress, 0.15, 0.85)
    for index, ((source, target), entrants) in enumerate(zip(wanted.directions, fields, strict=True)):
        part = SubProgress(whole, index / len(wanted.directions), 1.0 / len(wanted.directions), f"{source} to {target}")
        judges, missing = _judges(wanted.pose_methods, load_sensor(source), load_sensor(target))
        notes += [*entrants.excluded, *missing]
        jobs = [
            ScoringJob(
                recordings=one, source=source, target=target, candidates=entrants.candidates,
                training_recordings=tuple(u.target for u in usual), methods=wanted.methods, settings=wanted.settings,
                pose_methods=judges,
            )
            for one in pressed[select_sensors(source, target)]
        ]  # fmt: skip
        made = _here(jobs, part) if work is None else work(score_recording, jobs, part)
        found += build_rows(wanted.split, source, target, entrants.candidates, [one for those in made for one in those])
    return EvaluationTable(
        split=wanted.split, rows=tuple(_without_doubles(found)), notes=(*_about(wanted), *dict.fromkeys(notes))
    )


def _judges(names: Sequence[str], source: SensorSpec, target: SensorSpec) -> tuple[tuple[str, ...], list[str]]:
    """The pose methods that can judge touches of this target, and why others cannot."""
    able: list[str] = []
    missing: list[str] = []
    for name in names:
        method = BUILT_IN.method("pose", name)
        known = None if method.weights is None else method.weights(source, target, None)
        if isinstance(known, NoWeights):
            missing.append(f"no poses by {name} for {target.name}: {known.why}")
        else:
            able.append(name)
    return tuple(able), missing


def _check_settings(wanted: EvaluationRequest) -> None:
    """A setting of the touch is for those methods that have it; one that none has is a mistake."""
    known = {name for method in BUILT_IN.stage("touch").methods for name in list_settings(method.params())}
    for assignment in wanted.settings:
        slot, _, name = assignment.partition("=")[0].strip().partition(".")
        if slot == "touch" and name not in known:
            raise SettingProblem(f"no touch method has a parameter {name!r}; there are {', '.join(sorted(known))}")


def _here(jobs: Sequence[ScoringJob], progress: Progress) -> list[list[ScoredTouch]]:
    return [score_recording(job, SubProgress(progress, k / len(jobs), 1.0 / len(jobs))) for k, job in enumerate(jobs)]


def _without_doubles(found: Sequence[TableRow]) -> list[TableRow]:
    """The target's own touches, and what needs no source, once for each target."""
    kept: dict[tuple[str, ...], TableRow] = {}
    for row in found:
        own = row.candidate in ("recorded", "untouched", "mean")
        kept.setdefault((row.target, row.candidate) if own else (row.source, row.target, row.candidate), row)
    return list(kept.values())


def _about(wanted: EvaluationRequest) -> list[str]:
    """What the figures rest on, in words."""
    told = [
        f"{wanted.split.replace('_', ' ')}: {wanted.held_out.grasps} grasps of each object; sources are units that "
        f"differ by {wanted.held_out.sensor_variation:g} from the described ones, targets are as described"
    ]
    for target in dict.fromkeys(target for _, target in wanted.directions):
        encoder = touch_features.load_encoder_weights(load_sensor(target))
        if isinstance(encoder, Weights):
            told.append(f"encoder of {target}: {encoder.name}, {encoder.content_digest[:12]}")
        else:
            told.append(f"no Frechet or kernel distance for {target}: {encoder.why}")
    return told


def parse_direction(text: str) -> tuple[str, str]:
    """Source and target of `source:target`; raises SettingProblem for what is no such pair of known sensors."""
    source, arrow, target = (part.strip() for part in text.partition(":"))
    if not arrow or not source or not target:
        raise SettingProblem(f"a direction is written source:target, as gelslim:soft_bubble; got {text!r}")
    return load_sensor(source).name, load_sensor(target).name
