"""Offsets of an alignment from the opened one: a rotation about a point and a translation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np
from msgspec import Meta

from pipeline.base.arrays import Doubles
from pipeline.geometry import rigid
from pipeline.sensors.alignment import Alignment, correct_alignment

Axis = Literal["x", "y", "z", "rx", "ry", "rz"]
AXES: tuple[Axis, ...] = ("x", "y", "z", "rx", "ry", "rz")
Triple = tuple[float, float, float]
ZERO_TRIPLE: Triple = (0.0, 0.0, 0.0)
_Mm = Annotated[float, Meta(ge=-rigid.MAX_TRANSLATION_MM, le=rigid.MAX_TRANSLATION_MM)]
_Deg = Annotated[float, Meta(ge=-360.0, le=360.0)]
TranslationMm = tuple[_Mm, _Mm, _Mm]
RotationDeg = tuple[_Deg, _Deg, _Deg]  # rotation vector: axis times angle


@dataclass(frozen=True, slots=True, kw_only=True)
class Offsets:
    """A motion in the target frame after the opened T_S->T: a rotation about a pivot, then a translation.

    The pivot is the centre of the contact under the opened alignment, so that rotations are about the contact.
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
