"""Alignments as TOML files that people can read and edit.

Two tables, [alignment_from_source] and [target_from_alignment], hold a translation in mm and a
rotation vector in degrees each. The names of the two sensors above them prevent use of the file for
other sensors.
"""

import json
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from pipeline.core.arrays import Doubles, freeze
from pipeline.core.errors import FileProblem, escape_text
from pipeline.core.files import read_toml, write_text
from pipeline.core.geometry import rigid
from pipeline.core.typed_data import Name, Note, convert
from pipeline.sensors.alignment import ALIGNMENT_PARTS, Alignment, RotationDeg, TranslationMm

ALIGNMENT_SUFFIX = ".toml"
_COMMENTS = {
    "alignment_from_source": "the paper's T_S->A: maps points from the source frame to the "
    "alignment frame",
    "target_from_alignment": "the paper's T_A->T: maps points from the alignment frame to the "
    "target frame",
}


class _Transform(msgspec.Struct, kw_only=True, frozen=True):
    """A table of an alignment file."""

    translation_mm: TranslationMm
    rotation_deg: RotationDeg

    def to_matrix(self) -> Doubles:
        return freeze(rigid.from_parts(self.translation_mm, self.rotation_deg))


class _AlignmentTable(msgspec.Struct, kw_only=True, frozen=True):
    """All tables of an alignment file."""

    source: Name
    target: Name
    origin: Note = msgspec.field(name="from", default="")
    alignment_from_source: _Transform
    target_from_alignment: _Transform


@dataclass(frozen=True, slots=True, kw_only=True)
class AlignmentFile:
    """The content of an alignment file."""

    alignment: Alignment
    source: str  # names of sensors
    target: str
    origin: str = ""  # source of the numbers, as a text


def save_alignment(path: Path, content: AlignmentFile) -> None:
    """Write the file to a temporary one, then replace the old one, so that a crash leaves one of
    the two.

    Numbers are rounded to 1e-12. Raises FileProblem.
    """

    def read(written: Path) -> AlignmentFile:
        return load_alignment(written, source=content.source, target=content.target)

    write_text(path, format_alignment(content), "the alignment", read)


def format_alignment(content: AlignmentFile) -> str:
    """The text of the file."""
    lines = [
        f"# Alignment of {escape_text(content.source)} and {escape_text(content.target)} for the "
        "same touch.",
        "# Translations in mm, rotation vectors in degrees (axis times angle).",
        "# A sensor's frame is its camera's: x right, y down, z out along the optical axis.",
        f"source = {_quote(content.source)}",
        f"target = {_quote(content.target)}",
        f"from = {_quote(content.origin)}",
    ]
    for side in ALIGNMENT_PARTS:
        matrix: Doubles = getattr(content.alignment, side)
        lines += [
            "",
            f"[{side}]  # {_COMMENTS[side]}",
            f"translation_mm = {_format_numbers(matrix[:3, 3])}",
            f"rotation_deg = {_format_numbers(np.rad2deg(rigid.rotation_vector_rad(matrix)))}",
        ]
    return "\n".join(lines) + "\n"


class AlignmentMismatch(FileProblem):
    """An alignment is of other sensors than those chosen.

    `field` names the one that differs, "" the direction.
    """

    def __init__(self, what: str, content: AlignmentFile, path: Path, field: str = "") -> None:
        """Build the sentence, and keep the sensors that the file is of."""
        super().__init__(what, path, field=field)
        self.source = content.source
        self.target = content.target


def read_alignment(path: Path) -> AlignmentFile:
    """The alignment of a file, whichever its sensors; raises FileProblem."""
    table = convert(read_toml(path, "the alignment"), _AlignmentTable, "the alignment", path)
    alignment = Alignment(**{side: getattr(table, side).to_matrix() for side in ALIGNMENT_PARTS})
    return AlignmentFile(
        alignment=alignment, origin=table.origin, source=table.source, target=table.target
    )


def load_alignment(path: Path, *, source: str, target: str) -> AlignmentFile:
    """The alignment of a file, which must be for these two sensors; raises FileProblem."""
    content = read_alignment(path)
    if (content.source, content.target) == (target, source) != (source, target):
        raise AlignmentMismatch(
            f"this alignment is for {target} to {source}, the reverse direction; swap source and "
            "target",
            content,
            path,
        )
    for key, found, expected in (
        ("source", content.source, source),
        ("target", content.target, target),
    ):
        if found != expected:
            what = (
                f"this alignment has the {key} {found!r}, not {expected!r}; choose the file "
                "of these two sensors"
            )
            raise AlignmentMismatch(what, content, path, key)
    return content


def _format_numbers(values: Doubles) -> str:
    """A TOML list of numbers; + 0.0 removes the sign of a negative zero."""
    return "[" + ", ".join(repr(round(float(v), 12) + 0.0) for v in values) + "]"


def _quote(text: str) -> str:
    """A TOML string; JSON writes plain text in the same way."""
    return json.dumps(escape_text(text), ensure_ascii=False)
