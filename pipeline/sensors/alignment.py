"""The alignment of two sensors that record the same touch, through the alignment frame A."""

from dataclasses import dataclass
from typing import Literal

from pipeline.base.arrays import Doubles, freeze
from pipeline.geometry import rigid
from pipeline.sensors.spec import SensorSpec

AlignmentPart = Literal["alignment_from_source", "target_from_alignment"]  # the transform that stores a change
ALIGNMENT_PARTS: tuple[AlignmentPart, ...] = ("alignment_from_source", "target_from_alignment")


@dataclass(frozen=True, slots=True, kw_only=True)
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
    """The alignment by the two sensor descriptions, or by the T_S->T (4, 4) in mm of a recording."""
    inward, onward = source.alignment_from_sensor, rigid.invert(target.alignment_from_sensor)
    if recorded_target_from_source is not None:
        target_from_source = rigid.validate_rigid(recorded_target_from_source, "target_from_source of the recording")
        onward = target_from_source @ rigid.invert(inward)
    return Alignment(alignment_from_source=inward, target_from_alignment=freeze(onward))


def correct_alignment(
    alignment: Alignment, motion: Doubles, into: AlignmentPart = "target_from_alignment"
) -> Alignment:
    """The alignment whose T_S->T is `motion` @ the old one; `motion` is (4, 4) in the target frame, mm.

    The transform `into` stores the change, the other stays. Both are orthonormal.
    """
    onward, inward = alignment.target_from_alignment, alignment.alignment_from_source
    if into == "target_from_alignment":
        onward = freeze(rigid.validate_rigid(motion @ onward, "T_A->T"))
    else:
        inward = freeze(rigid.validate_rigid(rigid.invert(onward) @ motion @ onward @ inward, "T_S->A"))
    return Alignment(alignment_from_source=inward, target_from_alignment=onward)


def shift_alignment_along_z(alignment: Alignment, *, source_shift_mm: float, target_shift_mm: float) -> Alignment:
    """The alignment of two sensor instances whose cameras measure z smaller by these shifts than described."""
    if source_shift_mm == 0.0 and target_shift_mm == 0.0:
        return alignment
    inward = alignment.alignment_from_source @ rigid.translation(0.0, 0.0, source_shift_mm)
    onward = rigid.translation(0.0, 0.0, -target_shift_mm) @ alignment.target_from_alignment
    return Alignment(alignment_from_source=freeze(inward), target_from_alignment=freeze(onward))
