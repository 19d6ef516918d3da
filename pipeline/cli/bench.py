"""`tactoscope bench`: run the benchmarks, which are part of the source tree and not of the installed package."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from typing import Any

from pipeline.base.errors import FileProblem

PROJECT_FOLDER = Path(__file__).parents[2]


def load_bench_command() -> Any:
    """Import `benchmarks.harness.command`; raises FileProblem where the source tree is not there."""
    if not (PROJECT_FOLDER / "benchmarks" / "harness").is_dir():
        raise FileProblem("the benchmarks are part of the source tree; run bench there", PROJECT_FOLDER / "benchmarks")
    if str(PROJECT_FOLDER) not in sys.path:
        sys.path.insert(0, str(PROJECT_FOLDER))
    return importlib.import_module("benchmarks.harness.command")
