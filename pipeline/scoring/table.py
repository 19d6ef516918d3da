"""From scored touches to rows: one a direction and contender, the paper's own beside them."""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.base.arrays import Doubles
from pipeline.evaluation import distances
from pipeline.scoring.contenders import RECORDED, Contender
from pipeline.scoring.figures import pooled
from pipeline.scoring.paper import PaperRow, Split, Spread, paper_row
from pipeline.scoring.scored import Scored


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseFigures:
    """How far off an object's pose is that is told from the touches."""

    shift_mm: Spread  # mean and standard deviation, in the target's plane
    turn_deg: Spread
    answers: int  # touches that gave a pose


@dataclass(frozen=True, slots=True, kw_only=True)
class SetFigures:
    """How far generated touches as a set lie from true ones, beside two halves of the true ones."""

    frechet: float
    frechet_floor: float
    kernel: float
    kernel_floor: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One row of a table."""

    source: str
    target: str
    contender: str
    title: str
    touches: int
    figures: Mapping[str, Mapping[str, float]]  # of `FIGURES`: figure -> region -> value
    poses: Mapping[str, PoseFigures]  # method of the slot pose ->
    sets: SetFigures | None  # None: no encoder for this target, or too few touches
    ms: float  # median time of a touch
    paper: PaperRow | None
    notes: tuple[str, ...]


def rows(
    split: Split, source: str, target: str, contenders: Sequence[Contender], scored: Sequence[Scored]
) -> list[Row]:
    """The rows of one direction in the contenders' order; the target's own touches have poses alone."""
    by = {c.name: [one for one in scored if one.contender == c.name] for c in contenders}
    true = _features(by.get(RECORDED, []))
    made: list[Row] = []
    for contender in contenders:
        those = by[contender.name]
        if not those:
            continue
        own = contender.name == RECORDED
        made.append(Row(
            source="" if own else source, target=target, contender=contender.name, title=contender.title,
            touches=len(those), figures=pooled([one.figures for one in those]), poses=_poses(those),
            sets=None if own or true is None else _sets(_features(those), true),
            ms=statistics.median(one.ms for one in those),
            notes=tuple(dict.fromkeys(note for one in those for note in one.notes)),
            paper=paper_row(split, "" if own else source, target, contender.model) if own or contender.model else None,
        ))  # fmt: skip
    return made


def _features(those: Sequence[Scored]) -> Doubles | None:
    """(touches, features) of all, None where an encoder is missing."""
    seen = [one.features for one in those]
    kept = [f for f in seen if f is not None]
    return np.array(kept, np.float64) if kept and len(kept) == len(seen) else None


def _sets(made: Doubles | None, true: Doubles) -> SetFigures | None:
    if made is None or len(made) != len(true) or len(true) < 2 * distances.FEWEST:
        return None
    measured = {
        name: (distances.across_halves(distance, made, true), distances.floor(distance, true))
        for name, distance in (("frechet", distances.frechet), ("kernel", distances.kernel))
    }
    return SetFigures(
        frechet=measured["frechet"][0], frechet_floor=measured["frechet"][1],
        kernel=measured["kernel"][0], kernel_floor=measured["kernel"][1],
    )  # fmt: skip


def _poses(those: Sequence[Scored]) -> dict[str, PoseFigures]:
    found: dict[str, PoseFigures] = {}
    for method in dict.fromkeys(name for one in those for name in one.poses):
        errors = [one.poses[method] for one in those if method in one.poses]
        shift, turn = ([e[k] for e in errors if math.isfinite(e[k])] for k in (0, 1))
        if shift and turn:
            found[method] = PoseFigures(shift_mm=_spread(shift), turn_deg=_spread(turn), answers=len(shift))
    return found


def _spread(values: Sequence[float]) -> Spread:
    return statistics.fmean(values), statistics.pstdev(values)
