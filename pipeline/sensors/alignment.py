"""The alignment of two sensors that record the same touch, through the alignment frame A."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import numpy as np
from msgspec import Meta

from pipeline.core.arrays import Doubles, freeze
from pipeline.core.errors import FileProblem, escape_text
from pipeline.core.files import read_toml, write_text
from pipeline.core.frozen import frozen
from pipeline.core.geometry import rigid
from pipeline.core.typed_data import Name, Note, convert
from pipeline.sensors.spec import SensorSpec

ALIGNMENT_PARTS = ("alignment_from_source", "target_from_alignment")


@frozen
class Alignment:
    """Rigid transforms from source to target: the paper's T_S->A and T_A->T."""

    alignment_from_source: Doubles  # (4, 4) mm
    target_from_alignment: Doubles  # (4, 4) mm

    @property
    def target_from_source(self) -> Doubles:
        """The paper's T_S->T = T_A->T o T_S->A, composed in float64."""
        return self.target_from_alignment @ self.alignment_from_source


def resolve_alignment(
    source: SensorSpec, target: SensorSpec, recorded_target_from_source: Doubles | None = None
) -> Alignment:
    """The alignment by the two sensor descriptions, or by the T_S->T (4, 4) in mm of a
    recording.
    """
    inward = source.alignment_from_sensor
    onward = rigid.invert(target.alignment_from_sensor)
    if recorded_target_from_source is not None:
        target_from_source = rigid.validate_rigid(
            recorded_target_from_source, "target_from_source of the recording"
        )
        onward = target_from_source @ rigid.invert(inward)
    return Alignment(alignment_from_source=inward, target_from_alignment=freeze(onward))


def correct_alignment(alignment: Alignment, motion: Doubles) -> Alignment:
    """The alignment whose T_S->T is `motion` @ the old one.

    `motion` is (4, 4) in the target frame, mm. T_A->T stores the change, orthonormal.
    """
    onward = rigid.validate_rigid(motion @ alignment.target_from_alignment, "T_A->T")
    return replace(alignment, target_from_alignment=freeze(onward))


def shift_alignment_along_z(
    alignment: Alignment, *, source_shift_mm: float, target_shift_mm: float
) -> Alignment:
    """The alignment of two sensor instances whose cameras measure z smaller by these shifts than
    described.
    """
    if source_shift_mm == 0.0 and target_shift_mm == 0.0:
        return alignment
    inward = alignment.alignment_from_source @ rigid.translation(0.0, 0.0, source_shift_mm)
    onward = rigid.translation(0.0, 0.0, -target_shift_mm) @ alignment.target_from_alignment
    return Alignment(alignment_from_source=freeze(inward), target_from_alignment=freeze(onward))


Axis = Literal["x", "y", "z", "rx", "ry", "rz"]
AXES: tuple[Axis, ...] = ("x", "y", "z", "rx", "ry", "rz")
Triple = tuple[float, float, float]
ZERO_TRIPLE: Triple = (0.0, 0.0, 0.0)
_Mm = Annotated[float, Meta(ge=-rigid.MAX_TRANSLATION_MM, le=rigid.MAX_TRANSLATION_MM)]
_Deg = Annotated[float, Meta(ge=-360.0, le=360.0)]
TranslationMm = tuple[_Mm, _Mm, _Mm]
RotationDeg = tuple[_Deg, _Deg, _Deg]  # rotation vector: axis times angle


@frozen
class Offsets:
    """A motion in the target frame after the opened T_S->T: a rotation about a pivot, then a
    translation.

    The pivot is the centre of the contact under the opened alignment, so that rotations are about
    the contact.
    """

    translation_mm: TranslationMm = ZERO_TRIPLE
    rotation_deg: RotationDeg = ZERO_TRIPLE
    pivot_mm: TranslationMm = ZERO_TRIPLE  # target frame

    @property
    def values(self) -> tuple[float, ...]:
        """The six numbers in the order of `AXES`: x y z in mm, rx ry rz in degrees."""
        return (*self.translation_mm, *self.rotation_deg)

    @property
    def is_zero(self) -> bool:
        """Whether there is no motion."""
        return not any(self.values)

    def to_matrix(self) -> Doubles:
        """The motion (4, 4) in mm."""
        pivot, rotation_rad, translation = (
            np.array(v) for v in (self.pivot_mm, np.deg2rad(self.rotation_deg), self.translation_mm)
        )
        return compose_motion(pivot, rotation_rad, translation)

    def apply_to(self, opened: Alignment) -> Alignment:
        """The opened alignment with these offsets, stored in T_A->T."""
        return opened if self.is_zero else correct_alignment(opened, self.to_matrix())

    def with_axis_value(self, axis: Axis, value: float) -> Offsets:
        """Copy with another value for one axis, mm or degrees."""
        values = list(self.values)
        values[AXES.index(axis)] = value
        return replace(self, translation_mm=_triple(values[:3]), rotation_deg=_triple(values[3:]))

    def with_pivot(self, pivot_mm: Sequence[float] | Doubles) -> Offsets:
        """The same motion with another pivot (3,) mm."""
        return decompose_motion(self.to_matrix(), pivot_mm)


def compose_motion(pivot_mm: Doubles, rotation_rad: Doubles, translation_mm: Doubles) -> Doubles:
    """The motion (4, 4): a rotation vector (3,) about `pivot_mm` (3,), then a translation (3,)."""
    motion = rigid.rotation(rotation_rad)
    motion[:3, 3] = pivot_mm - motion[:3, :3] @ pivot_mm + translation_mm
    return motion


def decompose_motion(motion: Doubles, pivot_mm: Sequence[float] | Doubles) -> Offsets:
    """The offsets of a motion (4, 4) in the target frame for a pivot (3,) mm."""
    pivot = np.asarray(pivot_mm, dtype=np.float64)
    return Offsets(
        translation_mm=_triple(rigid.apply(motion, pivot) - pivot),
        rotation_deg=_triple(np.rad2deg(rigid.rotation_vector_rad(motion))),
        pivot_mm=_triple(pivot),
    )


def _triple(values: Sequence[float] | Doubles) -> Triple:
    x, y, z = (float(v) + 0.0 for v in values)
    return x, y, z


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


@frozen
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
        super().__init__(what, path)
        self.field = field
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
