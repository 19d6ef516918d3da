"""The distance of two points of a scene's surfaces."""

from __future__ import annotations

import numpy as np

from pipeline.core.arrays import Doubles
from pipeline.core.frozen import frozen
from pipeline.core.geometry import rigid
from pipeline.sensors.spec import SensorSpec
from pipeline.views.colours import REGISTERED_POINT_COLOUR, repeat_colour
from pipeline.views.display_params import DisplayParams
from pipeline.views.layers import Layer, make_lines_layer, stretch_depth
from pipeline.views.press_motion import SOURCE_SURFACES
from pipeline.views.scene import MEMBRANE_STAGES, ScenePlaces
from pipeline.views.view import to_xyz

Point3 = tuple[float, float, float]


@frozen
class SceneMeasure:
    """Up to two points: as they are drawn, and where they are without the stretched depth, mm."""

    drawn_mm: tuple[Point3, ...] = ()
    true_mm: tuple[Point3, ...] = ()

    def add_point(
        self,
        layer: str,
        place_mm: Point3,
        places: ScenePlaces,
        sensors: tuple[SensorSpec, SensorSpec],
        display: DisplayParams,
    ) -> SceneMeasure:
        """Return the measure with one more point of a layer; a third begins anew.

        `sensors` are source and target.
        """
        old = self if len(self.drawn_mm) < 2 else SceneMeasure()
        true_mm = place_mm
        for names, sensor, view_from_sensor in (
            (SOURCE_SURFACES, sensors[0], places.view_from_source),
            (MEMBRANE_STAGES, sensors[1], places.view_from_target),
        ):
            if layer in names:
                seen = rigid.apply(rigid.invert(view_from_sensor), np.array([place_mm]))
                flat = stretch_depth(seen, sensor, 1.0 / display.get_depth_stretch(sensor))
                true_mm = to_xyz(rigid.apply(view_from_sensor, flat)[0])
        return SceneMeasure(drawn_mm=(*old.drawn_mm, place_mm), true_mm=(*old.true_mm, true_mm))

    @property
    def length_mm(self) -> float:
        """The distance of both points; 0 while there are less."""
        return float(np.linalg.norm(np.subtract(self.true_mm[-1:], self.true_mm[:1])))

    @property
    def labels(self) -> dict[str, Point3]:
        """The distance in words, and where it is written."""
        if len(self.drawn_mm) < 2:
            return {}
        middle: Doubles = np.mean(self.drawn_mm, axis=0)
        return {f"{self.length_mm:.2f} mm": to_xyz(middle)}

    @property
    def layers(self) -> tuple[Layer, ...]:
        """The line between both points."""
        if not self.drawn_mm:
            return ()
        ends = np.array([(self.drawn_mm[0], self.drawn_mm[-1])], np.float32)
        return (make_lines_layer("measure", ends, repeat_colour(REGISTERED_POINT_COLOUR, 1)),)
