"""Display parameters; no method reads them."""

from dataclasses import replace
from typing import Literal

from pipeline.core.frozen import frozen
from pipeline.core.params import setting
from pipeline.sensors.spec import SensorSpec

_MOST_FLOOR = 0.95  # of the upper limit
_LEAST_RANGE_MM = 1.0  # of distances
# where no recording says how far its touches go
_USUAL_LIMITS_MM = {"gel": 1.5, "bubble": 10.0}

BubbleQuantity = Literal["deviation", "distance"]


@frozen
class DisplayParams:
    """Colour limits and depth stretch, in the units of the quantity."""

    gel_limit_mm: float = setting(
        0.0,
        "Gel indentation up to",
        unit="mm",
        low=0.0,
        high=3.0,
        step=0.1,
        help="upper colour limit for gels; 0 = fitted to the recording",
    )
    bubble_limit_mm: float = setting(
        0.0,
        "Bubble indentation up to",
        unit="mm",
        low=0.0,
        high=25.0,
        step=1.0,
        help="upper colour limit for bubbles; 0 = fitted to the recording",
    )
    gel_floor_mm: float = setting(
        0.0,
        "Gel indentation from",
        unit="mm",
        low=-1.0,
        high=2.9,
        step=0.1,
        help="lower colour limit for gels",
    )
    bubble_floor_mm: float = setting(
        0.0,
        "Bubble indentation from",
        unit="mm",
        low=-10.0,
        high=24.0,
        step=1.0,
        help="lower colour limit for bubbles",
    )
    bubble_quantity: BubbleQuantity = setting(
        "deviation",
        "Bubble frames as",
        choices=BubbleQuantity,
        help="deviation: from the rest shape, + toward the camera; distance: as the camera "
        "measures it",
    )
    bubble_near_mm: float = setting(
        0.0,
        "Bubble distance from",
        unit="mm",
        low=0.0,
        high=199.0,
        step=1.0,
        help="lower colour limit of a bubble's distances from its camera; 0 = as the sensor is "
        "built",
    )
    bubble_far_mm: float = setting(
        0.0,
        "Bubble distance up to",
        unit="mm",
        low=0.0,
        high=200.0,
        step=1.0,
        help="upper colour limit of a bubble's distances from its camera; 0 = as the recorded "
        "sensor instance is built",
    )
    residual_limit_mm: float = setting(
        0.5,
        "Distance to object up to",
        unit="mm",
        low=0.01,
        high=10.0,
        step=0.1,
        help="symmetric colour limit of the distance of registered points from the object",
    )
    gel_stretch: float = setting(
        3.0,
        "Gel depth in 3D times",
        low=1.0,
        high=10.0,
        step=0.5,
        help="stretches indentation of gels in the 3D views",
    )

    def get_depth_stretch(self, sensor: SensorSpec) -> float:
        """Return how many times deeper indentation is drawn in 3D; 1 for bubbles."""
        return self.gel_stretch if sensor.sensor_kind.display_group == "gel" else 1.0

    def get_limit_mm(self, sensor: SensorSpec) -> float:
        """Return the upper colour limit of indentations of this kind of sensor."""
        group = sensor.sensor_kind.display_group
        return getattr(self, f"{group}_limit_mm") or _USUAL_LIMITS_MM[group]

    def without_limits(self) -> "DisplayParams":
        """Copy with limits that are fitted to the next recording."""
        return replace(self, gel_limit_mm=0.0, bubble_limit_mm=0.0)

    def get_floor_mm(self, sensor: SensorSpec) -> float:
        """Return the lower colour limit of indentations, always below the upper one."""
        floor_mm = getattr(self, f"{sensor.sensor_kind.display_group}_floor_mm")
        return min(floor_mm, _MOST_FLOOR * self.get_limit_mm(sensor))

    def get_distance_limits_mm(self, built: tuple[float, float]) -> tuple[float, float]:
        """Return the colour limits of distances, the nearer one first.

        `built` where nothing else is set.
        """
        far = self.bubble_far_mm or built[1]
        return min(self.bubble_near_mm or built[0], far - _LEAST_RANGE_MM), far
