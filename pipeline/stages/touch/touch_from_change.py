"""A change of a sensor's reading as a touch, for methods that know the picture alone."""

from __future__ import annotations

import numpy as np

from pipeline.base.arrays import Floats, freeze
from pipeline.physics import optics
from pipeline.sensors.spec import SensorSpec
from pipeline.values.results import GeneratedTouch


def make_touch_from_change(target: SensorSpec, changed: Floats, notes: tuple[str, ...] = ()) -> GeneratedTouch:
    """A change (rows, cols, channels) of `target`: a gel's in shares of full brightness, a bubble's imprint in mm.

    It is laid onto the described unit's untouched reading; where a pixel comes from is not told.
    """
    shape = target.camera.shape
    if target.kind == "gel":
        grey = optics.render_reference(target) + np.float32(255.0) * changed
        image = np.clip(np.rint(grey), 0, 255).astype(np.uint8)
    else:
        image = (target.rest_depth_mm - changed[..., 0]).astype(np.float32)
    return GeneratedTouch(
        image=freeze(image), camera=target.camera, source_index=freeze(np.full(shape, -1, np.int32)),
        in_view=freeze(np.ones(shape, np.bool_)), notes=notes,
    )  # fmt: skip
