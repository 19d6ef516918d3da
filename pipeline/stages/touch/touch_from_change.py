"""Turns the change of a frame into a touch, for methods that generate images only."""

from __future__ import annotations

import numpy as np

from pipeline.base.arrays import Floats, freeze
from pipeline.sensors.spec import SensorSpec
from pipeline.values.results import GeneratedTouch


def make_touch_from_change(target: SensorSpec, change: Floats, notes: tuple[str, ...] = ()) -> GeneratedTouch:
    """Touch of a change (rows, cols, channels): a gel's in shares of full brightness, a bubble's imprint in mm.

    The change is added to the reference image of the described sensor; source pixels are unknown.
    """
    shape = target.camera.shape
    if target.kind == "gel":
        grey = optics.render_reference(target) + np.float32(255.0) * change
        image = np.clip(np.rint(grey), 0, 255).astype(np.uint8)
    else:
        image = (target.rest_depth_mm - change[..., 0]).astype(np.float32)
    return GeneratedTouch(
        image=freeze(image), camera=target.camera, source_index=freeze(np.full(shape, -1, np.int32)),
        in_view=freeze(np.ones(shape, np.bool_)), notes=notes,
    )  # fmt: skip
