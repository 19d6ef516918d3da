"""`tactoscope bench`: run time against error, ours and peers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pipeline.base.files import prepare_folder, prepare_folder_for, write_json
from pipeline.cli.terminal import print_line
from pipeline.racing.machine import THREAD_SETTINGS, describe_machine, format_machine
from pipeline.racing.plot import plot_result
from pipeline.racing.regressions import collect_measurements, find_regressions, read_measurements
from pipeline.racing.runner import BenchmarkRun, list_benchmarks, run_benchmark, select_benchmarks
from pipeline.racing.text_report import format_result


def print_benchmarks() -> int:
    """Print every question and what it needs."""
    known = list_benchmarks()
    width = max((len(question.name) for question in known), default=0)
    for question in known:
        needs = f" (by name only: needs {question.needs})" if question.needs else ""
        print_line(f"{question.name:<{width}}  {question.summary}{needs}")
    return 0


def run_benchmarks(
    names: Sequence[str], json_file: Path | None, plots: Path | None, *, against: Path | None = None, strict: bool
) -> int:
    """Ask the questions in turn and print, write and draw each answer as it comes.

    Returns 0; with `strict` 1 if a bar does not hold or a question has no answer, or, where there is an earlier run to
    hold this one `against`, if a row got worse than it was. Raises SettingProblem for an unknown name and FileProblem
    where the questions are not there, the earlier run cannot be read or a result cannot be written.
    """
    asked, before = select_benchmarks(names), {} if against is None else read_measurements(against)
    if json_file is not None:
        prepare_folder_for(json_file)
    if plots is not None:
        prepare_folder(plots)
    about = describe_machine(THREAD_SETTINGS)
    print_line(format_machine(about))
    done: list[BenchmarkRun] = []
    for question in asked:
        print_line("")
        print_line(question.name)
        done.append(run_benchmark(question))
        _tell(done[-1], plots)
        if json_file is not None:
            write_json(json_file, build_report(about, done))
    missed = _missed(done)
    print_line("")
    print_line(f"{len(missed)} missed: {'; '.join(missed)}" if missed else "every bar holds")
    if against is not None:
        missed = find_regressions(before, collect_measurements(done), [question.name for question in asked])
        print_line(f"against {against}: {len(missed) or 'none'} worse")
        for setback in missed:
            print_line(f"  {setback}")
    return 1 if strict and missed else 0


def build_report(about: dict[str, Any], done: Sequence[BenchmarkRun]) -> dict[str, Any]:
    """The machine, one row per claim, and what each question said beside its rows."""
    return {
        "machine": about,
        "rows": [row.as_json() for each in done if each.result for row in each.result.rows],
        "questions": [_question_json(each) for each in done],
    }


def _question_json(each: BenchmarkRun) -> dict[str, Any]:
    answer = each.result
    return {
        "name": each.benchmark.name,
        "title": answer.title if answer else each.benchmark.summary,
        "n_rows": len(answer.rows) if answer else 0,
        "unit": answer.unit if answer else "",
        "points": [asdict(point) for point in answer.points] if answer else [],
        "notes": answer.notes if answer else (),
        "problem": each.problem or None,
        "seconds": round(each.seconds, 1),
    }


def _tell(each: BenchmarkRun, plots: Path | None) -> None:
    if each.result is None:
        print_line(f"  no answer: {each.problem}")
        return
    for line in format_result(each.result).split("\n"):
        print_line(line)
    if plots is not None and plot_result(each.result, plots / f"{each.benchmark.name}.png"):
        print_line(f"  drawn as {plots / each.benchmark.name}.png")


def _missed(done: Sequence[BenchmarkRun]) -> list[str]:
    missed: list[str] = []
    for each in done:
        if each.result is None:
            missed.append(f"{each.benchmark.name} (no answer)")
        else:
            missed += [f"{row.question} ({row.bar})" for row in each.result.rows if not row.holds]
    return missed
