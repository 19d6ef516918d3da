"""The process that answers one question: `python -m pipeline.racing.worker QUESTION.py ANSWER.json`.

Between our own two processes numbers that are not finite travel as Python's JSON writes them (NaN).
"""

from __future__ import annotations

import importlib
import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pipeline.base.files import write_text
from pipeline.racing.results import BenchmarkResult


def main(question: str, out: str) -> None:
    """Answer the question and leave the answer at `out`."""
    answer = _module(Path(question)).answer()
    if not isinstance(answer, BenchmarkResult):
        raise TypeError(f"answer() of {Path(question).name} gave a {type(answer).__name__}, not an Answer")
    write_text(Path(out), json.dumps(asdict(answer), default=_number), "the answer")


def _module(path: Path) -> Any:
    """The module by its plain name, as when it is run alone: processes that it starts have to find it again."""
    sys.path.insert(0, str(path.parent))
    return importlib.import_module(path.stem)


def _number(value: object) -> object:
    """A number of numpy as Python's own."""
    as_python = getattr(value, "item", None)
    if as_python is None:
        raise TypeError(f"a {type(value).__name__} in an answer is no number")
    return as_python()


if __name__ == "__main__":
    main(*sys.argv[1:3])
