"""The questions of `benchmarks/`: which there are, what each needs, and its answer from a process of its own.

A question is a module with a function `answer() -> Answer`. A constant `NEEDS = "..."` says in words what it needs
beside the project (recorded data, a display); such a question is answered only when asked for by name.
"""

from __future__ import annotations

import ast
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipeline.base.errors import FileProblem, SettingProblem
from pipeline.racing.machine import THREAD_SETTINGS
from pipeline.racing.results import BenchmarkResult, Measurement, PlotPoint

BENCHMARK_FOLDER = Path(__file__).parents[2] / "benchmarks"
TIMEOUT_S = 1800.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Benchmark:
    """A module that answers, read but not imported."""

    name: str
    summary: str  # first line of its docstring
    needs: str  # "" = nothing beside the project
    path: Path


@dataclass(frozen=True, slots=True, kw_only=True)
class BenchmarkRun:
    """What asking a question came to: an answer, or the reason why there is none."""

    benchmark: Benchmark
    result: BenchmarkResult | None
    problem: str
    seconds: float


def list_benchmarks(folder: Path = BENCHMARK_FOLDER) -> tuple[Benchmark, ...]:
    """All questions, by name; raises FileProblem where the project's folder is not there."""
    read = [_read(path) for path in sorted(folder.glob("*.py"))]
    found = tuple(question for question in read if question is not None)
    if not found:
        raise FileProblem(
            "the questions are part of the project's source, not of the installed package; run bench there", folder
        )
    return found


def select_benchmarks(names: Sequence[str], folder: Path = BENCHMARK_FOLDER) -> tuple[Benchmark, ...]:
    """The questions named, in that order, or all that need nothing; raises SettingProblem for one that is unknown."""
    known = {question.name: question for question in list_benchmarks(folder)}
    for name in names:
        if name not in known:
            raise SettingProblem(f"no question {name!r}; there are {', '.join(known)}")
    return tuple(known[name] for name in dict.fromkeys(names)) or tuple(q for q in known.values() if not q.needs)


def run_benchmark(question: Benchmark, longest_s: float = TIMEOUT_S) -> BenchmarkRun:
    """Run the question in a process of its own with fixed threads; what goes wrong there is told, not raised."""
    started = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "answer.json"
        answer, problem = None, _run(question, out, longest_s)
        if not problem:
            answer = _answer(json.loads(out.read_text(encoding="utf-8")))
    return BenchmarkRun(benchmark=question, result=answer, problem=problem, seconds=time.monotonic() - started)


def _run(question: Benchmark, out: Path, longest_s: float) -> str:
    """Why the process left no answer in `out`; "" if it did."""
    command = [sys.executable, "-m", "pipeline.racing.worker", str(question.path), str(out)]
    try:
        done = subprocess.run(  # noqa: S603 (our own interpreter and module)
            command,
            cwd=Path(__file__).parents[2],
            env={**os.environ, **THREAD_SETTINGS},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            errors="replace",
            timeout=longest_s,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return f"no answer within {longest_s:g} s"
    if done.returncode < 0:
        return f"its process was ended by {signal.Signals(-done.returncode).name}"
    if done.returncode or not out.exists():
        lines = done.stderr.strip().splitlines()
        return lines[-1].strip() if lines else f"its process ended with status {done.returncode} and no answer"
    return ""


def _read(path: Path) -> Benchmark | None:
    """What a module says of itself; None if it answers nothing."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    if not any(isinstance(node, ast.FunctionDef) and node.name == "answer" for node in tree.body):
        return None
    about = (ast.get_docstring(tree) or path.stem).splitlines()[0]
    return Benchmark(name=path.stem, summary=about, needs=_needs(tree), path=path)


def _needs(tree: ast.Module) -> str:
    for node in tree.body:
        if (
            isinstance(node, ast.Assign)
            and isinstance(node.value, ast.Constant)
            and any(isinstance(target, ast.Name) and target.id == "NEEDS" for target in node.targets)
        ):
            return str(node.value.value)
    return ""


def _answer(said: dict[str, Any]) -> BenchmarkResult:
    return BenchmarkResult(
        title=said["title"],
        unit=said["unit"],
        rows=tuple(Measurement(**row) for row in said["rows"]),
        points=tuple(PlotPoint(**point) for point in said["points"]),
        notes=tuple(said["notes"]),
    )
