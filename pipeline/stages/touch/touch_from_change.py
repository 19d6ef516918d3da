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
    kind = target.sensor_kind
    scaled = np.float32(kind.full_change) * (change[..., 0] if kind.is_depth else change)
    image = kind.apply_change(target.render_reference(), scaled)
    return GeneratedTouch(
        image=freeze(image), camera=target.camera, source_index=freeze(np.full(shape, -1, np.int32)),
        in_view=freeze(np.ones(shape, np.bool_)), notes=notes,
    )  # fmt: skip
