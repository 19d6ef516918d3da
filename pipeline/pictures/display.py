"""How things are drawn; no method reads these."""

from __future__ import annotations

from dataclasses import dataclass

from pipeline.base.params import setting
from pipeline.sensors.spec import SensorSpec

_MOST_FLOOR = 0.95  # of the upper limit


@dataclass(frozen=True, slots=True, kw_only=True)
class DisplayParams:
    """Colour limits and stretch, in the units of the quantity."""

    gel_limit_mm: float = setting(
        1.5, "Gel indentation up to", unit="mm", low=0.1, high=3.0, step=0.1, help="upper colour limit for gels"
    )
    bubble_limit_mm: float = setting(
        10.0, "Bubble indentation up to", unit="mm", low=1.0, high=25.0, step=1.0, help="upper colour limit for bubbles"
    )
    gel_floor_mm: float = setting(
        0.0, "Gel indentation from", unit="mm", low=-1.0, high=2.9, step=0.1, help="lower colour limit for gels"
    )
    bubble_floor_mm: float = setting(
        0.0, "Bubble indentation from", unit="mm", low=-10.0, high=24.0, step=1.0, help="lower colour limit for bubbles"
    )
    gel_stretch: float = setting(
        3.0, "Gel depth in 3D times", low=1.0, high=10.0, step=0.5, help="stretches indentation of gels in the 3D views"
    )

    def stretch(self, sensor: SensorSpec) -> float:
        """How many times deeper indentation is drawn than it is; bubbles are deep enough as they are."""
        return self.gel_stretch if sensor.kind == "gel" else 1.0

    def limit_mm(self, sensor: SensorSpec) -> float:
        """Upper colour limit of indentations of this kind of sensor."""
        return self.gel_limit_mm if sensor.kind == "gel" else self.bubble_limit_mm

    def floor_mm(self, sensor: SensorSpec) -> float:
        """Lower colour limit of them, below the upper one whatever was set."""
        floor_mm = self.gel_floor_mm if sensor.kind == "gel" else self.bubble_floor_mm
        return min(floor_mm, _MOST_FLOOR * self.limit_mm(sensor))
