"""Alignments as TOML files that a person can read and edit.

Two tables, [alignment_from_source] and [target_from_alignment], each a shift in mm and a rotation vector in degrees;
the names of the two sensors above them, so that a file is not used for others by mistake.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np

from pipeline.base.arrays import Doubles, freeze
from pipeline.base.errors import FileProblem
from pipeline.base.files import read_toml, write_text
from pipeline.base.text import escape_text
from pipeline.geometry import rigid
from pipeline.sensors.alignment import ALIGNMENT_PARTS, Alignment

ALIGNMENT_SUFFIX = ".toml"
_MOST = {"translation_mm": rigid.FARTHEST_MM, "rotation_deg": 360.0}
_WHAT = {
    "alignment_from_source": "the paper's T_S->A: maps points of the source's camera frame to the alignment frame",
    "target_from_alignment": "the paper's T_A->T: maps points of the alignment frame to the target's camera frame",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class AlignmentFile:
    """An alignment with what its file says of it."""

    alignment: Alignment
    source: str  # names of sensors
    target: str
    origin: str = ""  # where the numbers come from, in words


def save_alignment(path: Path, kept: AlignmentFile) -> None:
    """Write the file, beside an old one first so that a crash leaves one of the two whole.

    What is read back differs from what was written by rounding alone, below 1e-12. Raises FileProblem.
    """
    write_text(path, format_alignment(kept), "the alignment")


def format_alignment(kept: AlignmentFile) -> str:
    """The file as text."""
    lines = [
        f"# How {escape_text(kept.source)} and {escape_text(kept.target)} stand to each other when they feel the same touch.",
        "# Shifts in mm, rotation vectors in degrees (axis times angle).",
        "# A sensor's frame is its camera's: x right, y down, z out along the optical axis.",
        f"source = {_quoted(kept.source)}",
        f"target = {_quoted(kept.target)}",
        f"from = {_quoted(kept.origin)}",
    ]
    for side in ALIGNMENT_PARTS:
        matrix: Doubles = getattr(kept.alignment, side)
        lines += [
            "",
            f"[{side}]  # {_WHAT[side]}",
            f"translation_mm = {_numbers(matrix[:3, 3])}",
            f"rotation_deg = {_numbers(np.rad2deg(rigid.rotation_vector_rad(matrix)))}",
        ]
    return "\n".join(lines) + "\n"


def load_alignment(path: Path, *, source: str, target: str) -> AlignmentFile:
    """The alignment of a file, for these two sensors; raises FileProblem that names the key and what to try."""
    data = read_toml(path, "the alignment")
    told = {key: _word(data, key, path) for key in ("source", "target")}
    if (told["source"], told["target"]) == (target, source) != (source, target):
        raise FileProblem(
            f"this alignment is for {target} to {source}, the other way round; swap source and target", path
        )
    for key, wanted in (("source", source), ("target", target)):
        if told[key] != wanted:
            raise FileProblem(
                f"this alignment has the {key} {told[key]!r}, not {wanted!r}; choose the file of these two sensors",
                path,
                field=key,
            )
    return AlignmentFile(
        alignment=Alignment(**{side: _transform(data, side, path) for side in ALIGNMENT_PARTS}),
        origin=_word(data, "from", path) if "from" in data else "",
        **told,
    )


def _word(data: dict[str, Any], key: str, path: Path) -> str:
    value = data.get(key)
    if not isinstance(value, str) or (not value and key != "from"):
        raise FileProblem(f'{key} of the alignment must be a text such as {key} = "gelslim"', path, field=key)
    return value


def _transform(data: dict[str, Any], side: str, path: Path) -> Doubles:
    table = data.get(side)
    if not isinstance(table, dict):
        raise FileProblem(
            f"the alignment lacks the table [{side}] with translation_mm and rotation_deg", path, field=side
        )
    values = cast("dict[str, Any]", table)
    shift, turn = (_three(values, side, key, most, path) for key, most in _MOST.items())
    return freeze(rigid.from_parts(shift, turn))


def _three(table: dict[str, Any], side: str, key: str, most: float, path: Path) -> list[float]:
    where = f"{side}.{key}"
    value: object = table.get(key)
    numbers = cast("list[object]", value) if isinstance(value, list) else []
    real = [n for n in numbers if isinstance(n, (int, float)) and not isinstance(n, bool)]
    if len(real) != 3 or len(numbers) != 3:
        raise FileProblem(f"{where} must be a list of three numbers, got {value!r}", path, field=where)
    if not all(abs(n) <= most for n in real):  # NaN is within nothing
        raise FileProblem(f"{where} must be three finite numbers within {most:g}, got {value!r}", path, field=where)
    return [float(n) for n in real]


def _numbers(values: Doubles) -> str:
    """Three numbers that read back as they were; + 0.0 takes the sign from a negative zero."""
    return "[" + ", ".join(repr(round(float(v), 12) + 0.0) for v in values) + "]"


def _quoted(text: str) -> str:
    """What JSON writes of plain text is TOML too."""
    return json.dumps(escape_text(text), ensure_ascii=False)
