"""A whole table: every direction of the paper, every contender, on one split of held-out touches."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from pipeline.base.errors import SettingProblem
from pipeline.base.params import settings
from pipeline.base.progress import SILENT, Progress, Share
from pipeline.networks.weights import NoWeights, Weights
from pipeline.scoring import features
from pipeline.scoring.contenders import field_of
from pipeline.scoring.held_out import HeldOut, recordings, sensors_for
from pipeline.scoring.paper import DIRECTIONS, NOTE, Split
from pipeline.scoring.scored import Job, Scored, scored
from pipeline.scoring.table import Row, rows
from pipeline.sensors.spec import SensorSpec, sensor
from pipeline.translation.catalogue import BUILT_IN

Map = Callable[[Callable[..., Any], Sequence[Job], Progress], Sequence[list[Scored]]]
USUAL_GRASPS = 3  # of each training object: what the mean touch is taken of
POSES = tuple(m.name for m in BUILT_IN.slot("pose").methods if m.name in ("signed_distances", "network"))


@dataclass(frozen=True, slots=True, kw_only=True)
class Wanted:
    """What to evaluate."""

    split: Split
    held_out: HeldOut = field(default_factory=HeldOut)
    directions: tuple[tuple[str, str], ...] = DIRECTIONS
    contenders: tuple[str, ...] = ()  # () = all
    methods: Mapping[str, str] = field(default_factory=dict)
    settings: tuple[str, ...] = ()
    poses: tuple[str, ...] = POSES


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """What came out."""

    split: Split
    rows: tuple[Row, ...]
    notes: tuple[str, ...]


def evaluated(wanted: Wanted, progress: Progress = SILENT, work: Map | None = None) -> Table:
    """Score and sum up; `work` maps the pieces elsewhere (other processes or machines), None does them here in turn.

    Raises SettingProblem for a direction, method or contender that does not exist, and what a method raises.
    """
    _check_settings(wanted)
    fields = [field_of(sensor(source), sensor(target), wanted.contenders) for source, target in wanted.directions]
    asked = dict.fromkeys(sensors_for(*direction) for direction in wanted.directions)
    pressed = {
        sensors: recordings(
            wanted.split, wanted.held_out, Share(progress, 0.1 * k / len(asked), 0.1 / len(asked)), sensors
        )
        for k, sensors in enumerate(asked)
    }
    usual = recordings("usual", replace(wanted.held_out, grasps=USUAL_GRASPS, vary=0.0), Share(progress, 0.1, 0.05))
    found: list[Row] = []
    notes: list[str] = [NOTE]
    whole = Share(progress, 0.15, 0.85)
    for index, ((source, target), entrants) in enumerate(zip(wanted.directions, fields, strict=True)):
        part = Share(whole, index / len(wanted.directions), 1.0 / len(wanted.directions), f"{source} to {target}")
        judges, missing = _judges(wanted.poses, sensor(source), sensor(target))
        notes += [*entrants.absent, *missing]
        jobs = [
            Job(
                presses=one, source=source, target=target, contenders=entrants.contenders,
                usual=tuple(u.target for u in usual), methods=wanted.methods, settings=wanted.settings,
                poses=judges,
            )
            for one in pressed[sensors_for(source, target)]
        ]  # fmt: skip
        made = _here(jobs, part) if work is None else work(scored, jobs, part)
        found += rows(wanted.split, source, target, entrants.contenders, [one for those in made for one in those])
    return Table(
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


def _check_settings(wanted: Wanted) -> None:
    """A setting of the touch is for those methods that have it; one that none has is a mistake."""
    known = {name for method in BUILT_IN.slot("touch").methods for name in settings(method.params())}
    for assignment in wanted.settings:
        slot, _, name = assignment.partition("=")[0].strip().partition(".")
        if slot == "touch" and name not in known:
            raise SettingProblem(f"no touch method has a parameter {name!r}; there are {', '.join(sorted(known))}")


def _here(jobs: Sequence[Job], progress: Progress) -> list[list[Scored]]:
    return [scored(job, Share(progress, k / len(jobs), 1.0 / len(jobs))) for k, job in enumerate(jobs)]


def _without_doubles(found: Sequence[Row]) -> list[Row]:
    """The target's own touches, and what needs no source, once for each target."""
    kept: dict[tuple[str, ...], Row] = {}
    for row in found:
        own = row.contender in ("recorded", "untouched", "mean")
        kept.setdefault((row.target, row.contender) if own else (row.source, row.target, row.contender), row)
    return list(kept.values())


def _about(wanted: Wanted) -> list[str]:
    """What the figures rest on, in words."""
    told = [
        f"{wanted.split.replace('_', ' ')}: {wanted.held_out.grasps} grasps of each object; sources are units that "
        f"differ by {wanted.held_out.vary:g} from the described ones, targets are as described"
    ]
    for target in dict.fromkeys(target for _, target in wanted.directions):
        encoder = features.weights(sensor(target))
        if isinstance(encoder, Weights):
            told.append(f"encoder of {target}: {encoder.name}, {encoder.content[:12]}")
        else:
            told.append(f"no Frechet or kernel distance for {target}: {encoder.why}")
    return told


def direction(text: str) -> tuple[str, str]:
    """Source and target of `source:target`; raises SettingProblem for what is no such pair of known sensors."""
    source, arrow, target = (part.strip() for part in text.partition(":"))
    if not arrow or not source or not target:
        raise SettingProblem(f"a direction is written source:target, as gelslim:soft_bubble; got {text!r}")
    return sensor(source).name, sensor(target).name
