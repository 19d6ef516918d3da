"""Run one benchmark: `python -m benchmarks.harness.worker BENCHMARK.py RESULT.json`.

Non-finite numbers are written as Python's JSON writes them (NaN).
"""

from __future__ import annotations

import importlib
import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

from benchmarks.harness.results import BenchmarkResult
from pipeline.base.files import write_text


def main(benchmark: str, out: str) -> None:
    """Run the benchmark module at path `benchmark` and write its result to `out`."""
    result = _module(Path(benchmark)).measure()
    if not isinstance(result, BenchmarkResult):
        raise TypeError(f"measure() of {Path(benchmark).name} gave a {type(result).__name__}, not a BenchmarkResult")
    write_text(Path(out), json.dumps(asdict(result), default=_number), "the result")


def _module(path: Path) -> Any:
    """Import the module by its plain name, so that processes that it starts can import it again."""
    sys.path.insert(0, str(path.parent))
    return importlib.import_module(path.stem)


def _number(value: object) -> object:
    """Convert a numpy number to a Python number."""
    as_python = getattr(value, "item", None)
    if as_python is None:
        raise TypeError(f"a {type(value).__name__} in a result is no number")
    return as_python()


if __name__ == "__main__":
    main(*sys.argv[1:3])
