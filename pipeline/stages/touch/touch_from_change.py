"""A change of a sensor's reading as a touch, for methods that know the picture alone."""

from __future__ import annotations

import numpy as np

from pipeline.base.arrays import Floats, freeze
from pipeline.sensors.spec import SensorSpec
from pipeline.values.results import GeneratedTouch


def make_touch_from_change(target: SensorSpec, changed: Floats, notes: tuple[str, ...] = ()) -> GeneratedTouch:
    """A change (rows, cols, channels) of `target`: a gel's in shares of full brightness, a bubble's imprint in mm.

    It is laid onto the described unit's untouched reading; where a pixel comes from is not told.
    """
    shape = target.camera.shape
    kind = target.sensor_kind
    change = np.float32(kind.full_change) * (changed[..., 0] if kind.is_depth else changed)
    image = kind.apply_change(target.render_reference(), change)
    return GeneratedTouch(
        image=freeze(image), camera=target.camera, source_index=freeze(np.full(shape, -1, np.int32)),
        in_view=freeze(np.ones(shape, np.bool_)), notes=notes,
    )  # fmt: skip
