"""`tactoscope bench`: run the benchmarks, which are part of the source tree and not of the
installed package.
"""

import importlib
import sys
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from pipeline.cli.translation_options import Flag
from pipeline.core.errors import FileProblem

PROJECT_FOLDER = Path(__file__).parents[2]


def bench(
    *names: str,
    json: Path | None = None,
    plots: Path | None = None,
    against: Path | None = None,
    strict: Flag = False,
    list_only: Annotated[bool, Parameter(name="--list", negative="")] = False,
) -> int:
    """Run benchmarks and print one row per claim; returns the exit code.

    Args:
        names: Benchmarks to run; default: all that need neither recorded data nor a display.
        json: File for the results, one row per claim.
        plots: Folder for one plot of run time against error per benchmark.
        against: Results of an earlier run. Rows that are worse by more than 10 % or no longer meet
            their requirement are listed.
        strict: Exit with 1 if a requirement is not met or a benchmark fails, or with --against if a
            row got worse.
        list_only: Only list the benchmarks.
    """
    command = _load_benchmark_command()
    if list_only:
        return command.print_benchmarks()
    return command.run_benchmarks(names, json, plots, against=against, strict=strict)


def _load_benchmark_command() -> Any:
    """Import `benchmarks.harness.command`; raises FileProblem outside the source tree."""
    if not (PROJECT_FOLDER / "benchmarks" / "harness").is_dir():
        raise FileProblem(
            "the benchmarks are part of the source tree; run bench there",
            PROJECT_FOLDER / "benchmarks",
        )
    if str(PROJECT_FOLDER) not in sys.path:
        sys.path.insert(0, str(PROJECT_FOLDER))
    return importlib.import_module("benchmarks.harness.command")
