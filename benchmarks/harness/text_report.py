"""A result in words: its rows as a table, its points, its notes, and the machine they come from."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence

from benchmarks.harness.results import BenchmarkResult, Measurement
from pipeline.core.machine import describe_machine, format_machine

_HEADS = (
    "question",
    "peer",
    "ours ms (p95)",
    "peer ms (p95)",
    "ratio",
    "our error",
    "peer error",
    "unit",
    "bar",
    "",
)
_WORDS = frozenset({0, 1, 7, 8, 9})  # columns that are words: to the left


def print_result(result: BenchmarkResult) -> None:
    """Print the result and the machine."""
    sys.stdout.write(format_result(result) + "\n" + format_machine(describe_machine()) + "\n")


def format_result(result: BenchmarkResult) -> str:
    """The result as lines of text, without the machine."""
    parts = (
        [result.title, _table([_HEADS, *(_cells(row) for row in result.rows)])]
        if result.rows
        else [result.title]
    )
    if result.points:
        points = [
            (p.method, format_number(p.ms), f"{format_number(p.error)} {result.unit}")
            for p in result.points
        ]
        parts.append(_table([("method", "ms", "error"), *points], {0}))
    return "\n".join([*parts, *(f"  - {note}" for note in result.notes)])


def format_number(value: float) -> str:
    """Three digits that matter; a dash for what is not known."""
    if not math.isfinite(value):
        return "-"
    return f"{value:.0f}" if 1e3 <= abs(value) < 1e6 else f"{value:.3g}"


def _cells(row: Measurement) -> tuple[str, ...]:
    return (
        row.question,
        row.peer or "-",
        _ms(row.ours_ms, row.ours_p95_ms),
        _ms(row.peer_ms, row.peer_p95_ms),
        f"{format_number(row.ratio)}x" if math.isfinite(row.ratio) else "-",
        format_number(row.ours_error),
        format_number(row.peer_error),
        row.unit,
        row.bar or "no bar",
        ("holds" if row.holds else "MISSED") if row.bar else "",
    )


def _ms(median: float, p95: float) -> str:
    if not math.isfinite(median):
        return "-"
    return (
        f"{format_number(median)} ({format_number(p95)})"
        if math.isfinite(p95)
        else format_number(median)
    )


def _table(lines: Sequence[Sequence[str]], words: frozenset[int] | set[int] = _WORDS) -> str:
    widths = [max(len(line[k]) for line in lines) for k in range(len(lines[0]))]
    return "\n".join(
        "  "
        + "  ".join(
            f"{cell:<{w}}" if k in words else f"{cell:>{w}}"
            for k, (cell, w) in enumerate(zip(line, widths, strict=True))
        ).rstrip()
        for line in lines
    )
