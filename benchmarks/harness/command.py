"""`tactoscope bench`: measure run time against error, ours and baselines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from benchmarks.harness.plot import plot_result
from benchmarks.harness.regressions import collect_measurements, find_regressions, read_measurements
from benchmarks.harness.runner import (
    BenchmarkRun,
    list_benchmarks,
    run_benchmark,
    select_benchmarks,
)
from benchmarks.harness.text_report import format_result
from pipeline.cli.terminal import print_line
from pipeline.core.files import check_folder, check_folder_for, write_json
from pipeline.core.machine import THREAD_SETTINGS, describe_machine, format_machine


def print_benchmarks() -> int:
    """Print every benchmark and what it needs."""
    known = list_benchmarks()
    width = max((len(benchmark.name) for benchmark in known), default=0)
    for benchmark in known:
        needs = f" (by name only: needs {benchmark.needs})" if benchmark.needs else ""
        print_line(f"{benchmark.name:<{width}}  {benchmark.summary}{needs}")
    return 0


def run_benchmarks(
    names: Sequence[str],
    json_file: Path | None,
    plots: Path | None,
    *,
    against: Path | None = None,
    strict: bool,
) -> int:
    """Run the benchmarks in turn; print, write and draw each result as soon as it is there.

    Returns 0; with `strict` 1 if a bar does not hold or a benchmark has no result, or, where there
    is an earlier run to hold this one `against`, if a row got worse than it was. Raises
    SettingProblem for an unknown name and FileProblem where the benchmarks are not there, the
    earlier run cannot be read or a result cannot be written.
    """
    selected = select_benchmarks(names)
    earlier = {} if against is None else read_measurements(against)
    if json_file is not None:
        check_folder_for(json_file)
    if plots is not None:
        check_folder(plots)
    about = describe_machine(THREAD_SETTINGS)
    print_line(format_machine(about))
    done: list[BenchmarkRun] = []
    for benchmark in selected:
        print_line("")
        print_line(benchmark.name)
        done.append(run_benchmark(benchmark))
        _print_run(done[-1], plots)
        if json_file is not None:
            write_json(json_file, build_report(about, done))
    missed = _missed(done)
    print_line("")
    print_line(f"{len(missed)} missed: {'; '.join(missed)}" if missed else "every bar holds")
    if against is not None:
        missed = find_regressions(
            earlier, collect_measurements(done), [benchmark.name for benchmark in selected]
        )
        print_line(f"against {against}: {len(missed) or 'none'} worse")
        for regression in missed:
            print_line(f"  {regression}")
    return 1 if strict and missed else 0


def build_report(about: dict[str, Any], done: Sequence[BenchmarkRun]) -> dict[str, Any]:
    """The machine, one row per claim, and the title, points and notes of each benchmark."""
    return {
        "machine": about,
        "rows": [row.as_json() for each in done if each.result for row in each.result.rows],
        "questions": [_benchmark_json(each) for each in done],
    }


def _benchmark_json(each: BenchmarkRun) -> dict[str, Any]:
    result = each.result
    return {
        "name": each.benchmark.name,
        "title": result.title if result else each.benchmark.summary,
        "n_rows": len(result.rows) if result else 0,
        "unit": result.unit if result else "",
        "points": [asdict(point) for point in result.points] if result else [],
        "notes": result.notes if result else (),
        "problem": each.problem or None,
        "seconds": round(each.seconds, 1),
    }


def _print_run(each: BenchmarkRun, plots: Path | None) -> None:
    if each.result is None:
        print_line(f"  no result: {each.problem}")
        return
    for line in format_result(each.result).split("\n"):
        print_line(line)
    if plots is not None and plot_result(each.result, plots / f"{each.benchmark.name}.png"):
        print_line(f"  drawn as {plots / each.benchmark.name}.png")


def _missed(done: Sequence[BenchmarkRun]) -> list[str]:
    missed: list[str] = []
    for each in done:
        if each.result is None:
            missed.append(f"{each.benchmark.name} (no result)")
        else:
            missed += [f"{row.question} ({row.bar})" for row in each.result.rows if not row.holds]
    return missed
