"""Cameras and section line as the session file stores them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

from pipeline.base.errors import FileProblem
from pipeline.translation.cross_section import SectionLine

N_CAMERA_NUMBERS = 10  # position (3), focal point (3), view-up (3), view angle
_MAX_COORDINATE_MM = 1000.0  # of the section line's ends; larger than any sensor


def parse_cameras(data: Mapping[str, Any], path: Path) -> Mapping[str, tuple[float, ...]]:
    """Return 3D view -> camera; raises FileProblem."""
    value = data.get("cameras", {})
    table = cast("dict[str, Any]", value) if isinstance(value, dict) else {"": ""}
    try:
        cameras = {name: tuple(float(number) for number in numbers) for name, numbers in table.items()}
    except (TypeError, ValueError):
        cameras = {"": ()}
    if any(len(numbers) != N_CAMERA_NUMBERS or not all(map(math.isfinite, numbers)) for numbers in cameras.values()):
        raise FileProblem(f"cameras must map views to {N_CAMERA_NUMBERS} numbers", path, field="cameras")
    return cameras


def parse_section_line(data: Mapping[str, Any], path: Path) -> SectionLine | None:
    """Return the section line, None if there is none; raises FileProblem."""
    value = data.get("section")
    if value is None:
        return None
    numbers = cast("list[Any]", value) if isinstance(value, list) else []
    if len(numbers) != 4 or not all(type(n) in (int, float) and abs(n) <= _MAX_COORDINATE_MM for n in numbers):
        raise FileProblem(f"section must be x, y of both ends in mm, got {value!r}", path,
                          field="section")  # fmt: skip
    x0, y0, x1, y1 = (float(n) for n in numbers)
    return SectionLine(begin_mm=(x0, y0), end_mm=(x1, y1))
