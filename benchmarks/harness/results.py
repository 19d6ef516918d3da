"""Run time against error, ours against a baseline: the values a benchmark returns.

A benchmark is a module of `benchmarks/` with a function `measure() -> BenchmarkResult`. `tactoscope
bench` runs each benchmark in a process of its own with a fixed number of threads, collects its rows
as JSON and draws time against error.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True, slots=True, kw_only=True)
class Measurement:
    """One claim: medians of both, ratio = baseline over ours.

    NaN without a baseline or an error.
    """

    question: str
    peer: str
    ours_ms: float
    peer_ms: float
    ratio: float
    ours_error: float
    peer_error: float
    unit: str  # of the errors
    bar: str
    holds: bool
    ours_p95_ms: float = math.nan
    peer_p95_ms: float = math.nan
    limit_ms: float = math.nan  # the most time and error that clear the bar; NaN = no requirement
    limit_error: float = math.nan

    def as_json(self) -> dict[str, Any]:
        """The row for a JSON file, which knows no NaN: null. The limits stay out: `bar` says
        them.
        """
        return {
            name: _plain(value)
            for name, value in asdict(self).items()
            if not name.startswith("limit_")
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class PlotPoint:
    """One method in a plot of run time against error."""

    method: str
    ms: float
    error: float
    ours: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class BenchmarkResult:
    """The measurements, plot points and notes of one benchmark."""

    title: str
    unit: str  # of the plotted errors
    rows: tuple[Measurement, ...]
    points: tuple[PlotPoint, ...] = ()
    notes: tuple[str, ...] = ()  # data, and what could not be raced


def _plain(value: object) -> object:
    return None if isinstance(value, float) and not math.isfinite(value) else value
