"""Compare a benchmark run with an earlier one: which claims got worse, and which no longer hold."""

from __future__ import annotations

import json
import math
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks.harness.results import Measurement
from benchmarks.harness.runner import BenchmarkRun
from benchmarks.harness.text_report import format_number
from pipeline.core.errors import FileProblem

# times as slow, or as far off: repeated runs on an idle machine differ by less
REGRESSION_FACTOR = 1.1


class MeasurementKey(NamedTuple):
    """What makes a row the same row in two runs."""

    benchmark: str  # name of the benchmark
    claim: str
    baseline: str
    unit: str


def collect_measurements(done: Sequence[BenchmarkRun]) -> dict[MeasurementKey, Measurement]:
    """The rows of benchmarks just measured."""
    return {
        _claim(each.benchmark.name, row): row
        for each in done
        if each.result
        for row in each.result.rows
    }


def read_measurements(path: Path) -> dict[MeasurementKey, Measurement]:
    """The rows that `tactoscope bench --json` left at `path`.

    Raises FileProblem for any other file.
    """
    try:
        report = json.loads(path.read_text(encoding="utf-8"))
        names = [
            benchmark["name"]
            for benchmark in report["questions"]
            for _ in range(benchmark["n_rows"])
        ]
        return {
            _claim(name, row): row
            for name, row in zip(names, map(_row, report["rows"]), strict=True)
        }
    except OSError as error:
        raise FileProblem(f"cannot read the earlier run ({error.strerror})", path) from error
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise FileProblem("this is no result of 'tactoscope bench --json'", path) from error


def find_regressions(
    before: Mapping[MeasurementKey, Measurement],
    now: Mapping[MeasurementKey, Measurement],
    names: Collection[str],
) -> list[str]:
    """One sentence per row of these benchmarks that is missing, no longer holds, or is over a
    tenth worse.
    """
    sentences: list[str] = []
    for claim, old in before.items():
        if claim.benchmark in names:
            worse = _worse(old, now[claim]) if claim in now else ["there is no such row any more"]
            against = f" against {claim.baseline}" if claim.baseline else ""
            sentences += (
                [f"{claim.benchmark}: {claim.claim}{against}: {', '.join(worse)}"] if worse else []
            )
    return sentences


def _worse(old: Measurement, new: Measurement) -> list[str]:
    """Speed is judged against the baseline of the same run where there is one: a busy machine
    slows both.
    """
    parts = [f"no longer holds ({new.bar})"] if old.bar and old.holds and not new.holds else []
    if math.isfinite(old.ratio) and math.isfinite(new.ratio):
        if new.ratio < old.ratio / REGRESSION_FACTOR:
            parts.append(
                f"{format_number(old.ratio)}x -> {format_number(new.ratio)}x as fast as the peer"
            )
    elif new.ours_ms > REGRESSION_FACTOR * old.ours_ms:
        parts.append(f"{format_number(old.ours_ms)} -> {format_number(new.ours_ms)} ms")
    if new.ours_error > REGRESSION_FACTOR * old.ours_error or math.isnan(
        new.ours_error
    ) > math.isnan(old.ours_error):
        parts.append(
            f"error {format_number(old.ours_error)} -> {format_number(new.ours_error)} "
            f"{new.unit}".rstrip()
        )
    return parts


def _row(record: dict[str, Any]) -> Measurement:
    values: dict[str, Any] = {
        name: math.nan if value is None else value for name, value in record.items()
    }
    return Measurement(**values)


def _claim(benchmark: str, row: Measurement) -> MeasurementKey:
    return MeasurementKey(benchmark=benchmark, claim=row.question, baseline=row.peer, unit=row.unit)
