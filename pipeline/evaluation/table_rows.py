"""From scored touches to rows: one a direction and contender, the paper's own beside them."""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.base.arrays import Doubles
from pipeline.evaluation.candidates import RECORDED, Candidate
from pipeline.evaluation.published_results import MeanStd, PaperRow, Split, find_paper_row
from pipeline.evaluation.touch_metrics import pool_metrics
from pipeline.evaluation.touch_scoring import ScoredTouch
from pipeline.metrics import set_distances


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseErrors:
    """How far off an object's pose is that is told from the touches."""

    translation_mm: MeanStd  # mean and standard deviation, in the target's plane
    rotation_deg: MeanStd
    n_poses: int  # touches that gave a pose


@dataclass(frozen=True, slots=True, kw_only=True)
class SetDistances:
    """How far generated touches as a set lie from true ones, beside two halves of the true ones."""

    frechet: float
    frechet_floor: float
    kernel: float
    kernel_floor: float


@dataclass(frozen=True, slots=True, kw_only=True)
class TableRow:
    """One row of a table."""

    source: str
    target: str
    candidate: str
    title: str
    n_touches: int
    metrics: Mapping[str, Mapping[str, float]]  # of `FIGURES`: figure -> region -> value
    pose_errors: Mapping[str, PoseErrors]  # method of the slot pose ->
    set_distances: SetDistances | None  # None: no encoder for this target, or too few touches
    ms: float  # median time of a touch
    paper: PaperRow | None
    notes: tuple[str, ...]


def build_rows(
    split: Split, source: str, target: str, contenders: Sequence[Candidate], scored: Sequence[ScoredTouch]
) -> list[TableRow]:
    """The rows of one direction in the contenders' order; the target's own touches have poses alone."""
    by = {c.name: [one for one in scored if one.candidate == c.name] for c in contenders}
    true = _features(by.get(RECORDED, []))
    made: list[TableRow] = []
    for contender in contenders:
        those = by[contender.name]
        if not those:
            continue
        own = contender.name == RECORDED
        made.append(TableRow(
            source="" if own else source, target=target, candidate=contender.name, title=contender.title,
            n_touches=len(those), metrics=pool_metrics([one.metrics for one in those]), pose_errors=_poses(those),
            set_distances=None if own or true is None else _sets(_features(those), true),
            ms=statistics.median(one.ms for one in those),
            notes=tuple(dict.fromkeys(note for one in those for note in one.notes)),
            paper=find_paper_row(split, "" if own else source, target, contender.paper_model) if own or contender.paper_model else None,
        ))  # fmt: skip
    return made


def _features(those: Sequence[ScoredTouch]) -> Doubles | None:
    """(touches, features) of all, None where an encoder is missing."""
    seen = [one.features for one in those]
    kept = [f for f in seen if f is not None]
    return np.array(kept, np.float64) if kept and len(kept) == len(seen) else None


def _sets(made: Doubles | None, true: Doubles) -> SetDistances | None:
    if made is None or len(made) != len(true) or len(true) < 2 * set_distances.MIN_TOUCHES:
        return None
    measured = {
        name: (set_distances.compare_halves(distance, made, true), set_distances.compute_floor(distance, true))
        for name, distance in (("frechet", set_distances.frechet_distance), ("kernel", set_distances.kernel_distance))
    }
    return SetDistances(
        frechet=measured["frechet"][0], frechet_floor=measured["frechet"][1],
        kernel=measured["kernel"][0], kernel_floor=measured["kernel"][1],
    )  # fmt: skip


def _poses(those: Sequence[ScoredTouch]) -> dict[str, PoseErrors]:
    found: dict[str, PoseErrors] = {}
    for method in dict.fromkeys(name for one in those for name in one.pose_errors):
        errors = [one.pose_errors[method] for one in those if method in one.pose_errors]
        shift, turn = ([e[k] for e in errors if math.isfinite(e[k])] for k in (0, 1))
        if shift and turn:
            found[method] = PoseErrors(translation_mm=_spread(shift), rotation_deg=_spread(turn), n_poses=len(shift))
    return found


def _spread(values: Sequence[float]) -> MeanStd:
    return statistics.fmean(values), statistics.pstdev(values)
