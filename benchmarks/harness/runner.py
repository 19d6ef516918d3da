"""List the modules of `benchmarks/` and run each in a process of its own.

A benchmark is a module with a function `measure() -> BenchmarkResult`. A constant `NEEDS = "..."`
says what it needs beyond the project (recorded data, a display); such a benchmark runs only when it
is named.
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

from benchmarks.harness.results import BenchmarkResult, Measurement, PlotPoint
from pipeline.core.errors import FileProblem, SettingProblem
from pipeline.core.machine import THREAD_SETTINGS

BENCHMARK_FOLDER = Path(__file__).parents[2] / "benchmarks"
TIMEOUT_S = 1800.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Benchmark:
    """A benchmark module, parsed but not imported."""

    name: str
    summary: str  # first line of its docstring
    needs: str  # "" = nothing beyond the project
    path: Path


@dataclass(frozen=True, slots=True, kw_only=True)
class BenchmarkRun:
    """What asking a benchmark came to: a result, or the reason why there is none."""

    benchmark: Benchmark
    result: BenchmarkResult | None
    problem: str
    seconds: float


def list_benchmarks(folder: Path = BENCHMARK_FOLDER) -> tuple[Benchmark, ...]:
    """All benchmarks, by name; raises FileProblem where the project's folder is not there."""
    read = [_read(path) for path in sorted(folder.glob("*.py"))]
    found = tuple(benchmark for benchmark in read if benchmark is not None)
    if not found:
        raise FileProblem(
            "the benchmarks are part of the project's source, not of the installed package; run "
            "bench there",
            folder,
        )
    return found


def select_benchmarks(
    names: Sequence[str], folder: Path = BENCHMARK_FOLDER
) -> tuple[Benchmark, ...]:
    """The benchmarks named, in that order, or all that need nothing.

    Raises SettingProblem for one that is unknown.
    """
    known = {benchmark.name: benchmark for benchmark in list_benchmarks(folder)}
    for name in names:
        if name not in known:
            raise SettingProblem(f"no benchmark {name!r}; there are {', '.join(known)}")
    return tuple(known[name] for name in dict.fromkeys(names)) or tuple(
        q for q in known.values() if not q.needs
    )


def run_benchmark(benchmark: Benchmark, timeout_s: float = TIMEOUT_S) -> BenchmarkRun:
    """Run the benchmark in a process of its own with fixed threads.

    A failure is returned as `problem`.
    """
    started = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "result.json"
        result = None
        problem = _run(benchmark, out, timeout_s)
        if not problem:
            result = _parse_result(json.loads(out.read_text(encoding="utf-8")))
    return BenchmarkRun(
        benchmark=benchmark, result=result, problem=problem, seconds=time.monotonic() - started
    )


def _run(benchmark: Benchmark, out: Path, timeout_s: float) -> str:
    """Why the process left no result in `out`; "" if it did."""
    command = [sys.executable, "-m", "benchmarks.harness.worker", str(benchmark.path), str(out)]
    try:
        done = subprocess.run(
            command,
            cwd=Path(__file__).parents[2],
            env={**os.environ, **THREAD_SETTINGS},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            errors="replace",
            timeout=timeout_s,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return f"no result within {timeout_s:g} s"
    if done.returncode < 0:
        return f"its process was ended by {signal.Signals(-done.returncode).name}"
    if done.returncode or not out.exists():
        lines = done.stderr.strip().splitlines()
        return (
            lines[-1].strip()
            if lines
            else f"its process ended with status {done.returncode} and no result"
        )
    return ""


def _read(path: Path) -> Benchmark | None:
    """What a module says of itself; None if it results nothing."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    if not any(isinstance(node, ast.FunctionDef) and node.name == "measure" for node in tree.body):
        return None
    about = (ast.get_docstring(tree) or path.stem).splitlines()[0]
    return Benchmark(name=path.stem, summary=about, needs=_needs(tree), path=path)


def _needs(tree: ast.Module) -> str:
    for node in tree.body:
        if (
            isinstance(node, ast.Assign)
            and isinstance(node.value, ast.Constant)
            and any(
                isinstance(target, ast.Name) and target.id == "NEEDS" for target in node.targets
            )
        ):
            return str(node.value.value)
    return ""


def _parse_result(record: dict[str, Any]) -> BenchmarkResult:
    return BenchmarkResult(
        title=record["title"],
        unit=record["unit"],
        rows=tuple(Measurement(**row) for row in record["rows"]),
        points=tuple(PlotPoint(**point) for point in record["points"]),
        notes=tuple(record["notes"]),
    )
