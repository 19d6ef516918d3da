"""A run of the bench beside an earlier one: which claims got worse, and which no longer hold."""

from __future__ import annotations

import json
import math
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from pipeline.base.errors import FileProblem
from pipeline.racing.questions import Answered
from pipeline.racing.races import Row
from pipeline.racing.report import number

WORSE = 1.1  # times as slow, or as far off: repeated runs on an idle machine differ by less


class Claim(NamedTuple):
    """What makes a row the same row in two runs."""

    asked: str  # name of the question
    claim: str
    peer: str
    unit: str


def rows_of(done: Sequence[Answered]) -> dict[Claim, Row]:
    """The rows of questions just answered."""
    return {_claim(each.question.name, row): row for each in done if each.answer for row in each.answer.rows}


def read_rows(path: Path) -> dict[Claim, Row]:
    """The rows that `tactoscope bench --json` left at `path`; raises FileProblem for any other file."""
    try:
        said = json.loads(path.read_text(encoding="utf-8"))
        names = [question["name"] for question in said["questions"] for _ in range(question["n_rows"])]
        return {_claim(name, row): row for name, row in zip(names, map(_row, said["rows"]), strict=True)}
    except OSError as error:
        raise FileProblem(f"cannot read the earlier run ({error.strerror})", path) from error
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise FileProblem("this is no result of 'tactoscope bench --json'", path) from error


def setbacks(before: Mapping[Claim, Row], now: Mapping[Claim, Row], asked: Collection[str]) -> list[str]:
    """One sentence for each row of the questions `asked` that is gone, no longer holds, or is worse by over a tenth."""
    told: list[str] = []
    for claim, old in before.items():
        if claim.asked in asked:
            worse = _worse(old, now[claim]) if claim in now else ["there is no such row any more"]
            beside = f" beside {claim.peer}" if claim.peer else ""
            told += [f"{claim.asked}: {claim.claim}{beside}: {', '.join(worse)}"] if worse else []
    return told


def _worse(old: Row, new: Row) -> list[str]:
    """Speed is judged against the peer of the same run where there is one: a busy machine slows both."""
    parts = [f"no longer holds ({new.bar})"] if old.bar and old.holds and not new.holds else []
    if math.isfinite(old.ratio) and math.isfinite(new.ratio):
        if new.ratio < old.ratio / WORSE:
            parts.append(f"{number(old.ratio)}x -> {number(new.ratio)}x as fast as the peer")
    elif new.ours_ms > WORSE * old.ours_ms:
        parts.append(f"{number(old.ours_ms)} -> {number(new.ours_ms)} ms")
    if new.ours_error > WORSE * old.ours_error or math.isnan(new.ours_error) > math.isnan(old.ours_error):
        parts.append(f"error {number(old.ours_error)} -> {number(new.ours_error)} {new.unit}".rstrip())
    return parts


def _row(said: dict[str, Any]) -> Row:
    values: dict[str, Any] = {name: math.nan if value is None else value for name, value in said.items()}
    return Row(**values)


def _claim(asked: str, row: Row) -> Claim:
    return Claim(asked=asked, claim=row.question, peer=row.peer, unit=row.unit)
