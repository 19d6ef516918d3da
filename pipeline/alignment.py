"""How two sensors that feel the same touch stand to each other, by way of the alignment frame A."""

from __future__ import annotations

from dataclasses import dataclass

from pipeline import rigid
from pipeline.arrays import Doubles, freeze
from pipeline.sensors.spec import SensorSpec


@dataclass(frozen=True, slots=True, kw_only=True)
class Alignment:
    """The paper's T_S->A and T_A->T."""

    alignment_from_source: Doubles  # (4, 4) mm
    target_from_alignment: Doubles  # (4, 4) mm

    @property
    def target_from_source(self) -> Doubles:
        """The paper's T_S->T = T_A->T o T_S->A, composed in float64."""
        return self.target_from_alignment @ self.alignment_from_source


def between(source: SensorSpec, target: SensorSpec) -> Alignment:
    """The alignment that the two sensor descriptions state."""
    return Alignment(
        alignment_from_source=source.alignment_from_sensor,
        target_from_alignment=freeze(rigid.invert(target.alignment_from_sensor)),
    )
