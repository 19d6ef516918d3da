"""Where somebody looks, as a session file keeps it: turning a view or moving a line is no change to be saved."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

from pipeline.base.errors import FileProblem
from pipeline.translation.cross_section import SectionLine

N_CAMERA_NUMBERS = 10  # where from, where to, upwards, and the angle
_FARTHEST_MM = 1000.0  # of a line's ends: no gel is as large


def parse_cameras(data: Mapping[str, Any], path: Path) -> Mapping[str, tuple[float, ...]]:
    """3D view -> its camera; none at all in files from before they were kept."""
    said = data.get("cameras", {})
    known = cast("dict[str, Any]", said) if isinstance(said, dict) else {"": ""}
    try:
        cameras = {name: tuple(float(number) for number in numbers) for name, numbers in known.items()}
    except (TypeError, ValueError):
        cameras = {"": ()}
    if any(len(numbers) != N_CAMERA_NUMBERS or not all(map(math.isfinite, numbers)) for numbers in cameras.values()):
        raise FileProblem(f"cameras must map views to {N_CAMERA_NUMBERS} numbers", path, field="cameras")
    return cameras


def parse_section_line(data: Mapping[str, Any], path: Path) -> SectionLine | None:
    """The section line; None where there was none, or in files from before there was one."""
    said = data.get("section")
    if said is None:
        return None
    numbers = cast("list[Any]", said) if isinstance(said, list) else []
    if len(numbers) != 4 or not all(type(n) in (int, float) and abs(n) <= _FARTHEST_MM for n in numbers):
        raise FileProblem(f"section must be x, y of its beginning and its end in mm, got {said!r}", path,
                          field="section")  # fmt: skip
    x0, y0, x1, y1 = (float(n) for n in numbers)
    return SectionLine(begin_mm=(x0, y0), end_mm=(x1, y1))
