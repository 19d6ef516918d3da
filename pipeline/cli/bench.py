"""`tactoscope bench`: run time against error, ours and peers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pipeline.base.files import ready, ready_for, write_json
from pipeline.cli.terminal import print_line
from pipeline.racing.comparison import read_rows, rows_of, setbacks
from pipeline.racing.machine import THREAD_SETTINGS, machine, machine_line
from pipeline.racing.plot import plot
from pipeline.racing.questions import Answered, ask, chosen, questions
from pipeline.racing.report import text


def list_questions() -> int:
    """Print every question and what it needs."""
    known = questions()
    width = max((len(question.name) for question in known), default=0)
    for question in known:
        needs = f" (by name only: needs {question.needs})" if question.needs else ""
        print_line(f"{question.name:<{width}}  {question.about}{needs}")
    return 0


def bench(
    names: Sequence[str], json_file: Path | None, plots: Path | None, *, against: Path | None = None, strict: bool
) -> int:
    """Ask the questions in turn and print, write and draw each answer as it comes.

    Returns 0; with `strict` 1 if a bar does not hold or a question has no answer, or, where there is an earlier run to
    hold this one `against`, if a row got worse than it was. Raises SettingProblem for an unknown name and FileProblem
    where the questions are not there, the earlier run cannot be read or a result cannot be written.
    """
    asked, before = chosen(names), {} if against is None else read_rows(against)
    if json_file is not None:
        ready_for(json_file)
    if plots is not None:
        ready(plots)
    about = machine(THREAD_SETTINGS)
    print_line(machine_line(about))
    done: list[Answered] = []
    for question in asked:
        print_line("")
        print_line(question.name)
        done.append(ask(question))
        _tell(done[-1], plots)
        if json_file is not None:
            write_json(json_file, as_json(about, done))
    missed = _missed(done)
    print_line("")
    print_line(f"{len(missed)} missed: {'; '.join(missed)}" if missed else "every bar holds")
    if against is not None:
        missed = setbacks(before, rows_of(done), [question.name for question in asked])
        print_line(f"against {against}: {len(missed) or 'none'} worse")
        for setback in missed:
            print_line(f"  {setback}")
    return 1 if strict and missed else 0


def as_json(about: dict[str, Any], done: Sequence[Answered]) -> dict[str, Any]:
    """The machine, one row per claim, and what each question said beside its rows."""
    return {
        "machine": about,
        "rows": [row.as_json() for each in done if each.answer for row in each.answer.rows],
        "questions": [_question_json(each) for each in done],
    }


def _question_json(each: Answered) -> dict[str, Any]:
    answer = each.answer
    return {
        "name": each.question.name,
        "title": answer.title if answer else each.question.about,
        "n_rows": len(answer.rows) if answer else 0,
        "unit": answer.unit if answer else "",
        "points": [asdict(point) for point in answer.points] if answer else [],
        "notes": answer.notes if answer else (),
        "problem": each.problem or None,
        "seconds": round(each.seconds, 1),
    }


def _tell(each: Answered, plots: Path | None) -> None:
    if each.answer is None:
        print_line(f"  no answer: {each.problem}")
        return
    for line in text(each.answer).split("\n"):
        print_line(line)
    if plots is not None and plot(each.answer, plots / f"{each.question.name}.png"):
        print_line(f"  drawn as {plots / each.question.name}.png")


def _missed(done: Sequence[Answered]) -> list[str]:
    missed: list[str] = []
    for each in done:
        if each.answer is None:
            missed.append(f"{each.question.name} (no answer)")
        else:
            missed += [f"{row.question} ({row.bar})" for row in each.answer.rows if not row.holds]
    return missed
