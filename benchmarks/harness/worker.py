"""Run one benchmark: `python -m benchmarks.harness.worker BENCHMARK.py RESULT.json`.

Numbers of numpy become those of Python, and non-finite ones are written as its JSON writes them
(NaN).
"""

from __future__ import annotations

import importlib
import json
import sys
from dataclasses import asdict
from operator import methodcaller
from pathlib import Path

from benchmarks.harness.results import BenchmarkResult
from pipeline.core.files import write_text


def main(benchmark: str, out: str) -> None:
    """Run the benchmark module at path `benchmark` and write its result to `out`."""
    path = Path(benchmark)
    # the plain name: processes that the module starts can import it again
    sys.path.insert(0, str(path.parent))
    result = importlib.import_module(path.stem).measure()
    if not isinstance(result, BenchmarkResult):
        raise TypeError(
            f"measure() of {path.name} gave a {type(result).__name__}, not a BenchmarkResult"
        )
    write_text(
        Path(out), json.dumps(asdict(result), default=methodcaller("item")), "the result", None
    )


if __name__ == "__main__":
    main(*sys.argv[1:3])
