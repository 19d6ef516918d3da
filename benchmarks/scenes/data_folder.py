"""Where recorded data lie that are not part of the project: for questions whose `NEEDS` says so.

Not a question itself.
"""

from __future__ import annotations

import os
from pathlib import Path

from pipeline.base.errors import FileProblem

_BESIDE = Path(__file__).resolve().parents[2] / "shared" / "data"


def recorded_data(given: str = "") -> Path:
    """The folder given, or that of TACTILE_DATA, or the one next to the project; raises FileProblem without any."""
    folder = Path(given or os.environ.get("TACTILE_DATA", _BESIDE))
    if not folder.is_dir():
        raise FileProblem("there are no recorded data here; set TACTILE_DATA to their folder", folder)
    return folder
