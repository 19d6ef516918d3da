"""A look-up from presses of a ball that is better than what the depth stage reads without any.

The stage knows more than the built-in look-up (`gel_light`), so that presses have to do better than the stage: it is
asked what it makes of every press.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pipeline.base.arrays import Floats, Image
from pipeline.base.progress import SILENT, Progress
from pipeline.calibration.balls import calibrate_balls
from pipeline.calibration.calibration_table import Calibration, make_built_in
from pipeline.physics.slopes import compute_slopes
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth.photometric import DepthParams, estimate_depth
from pipeline.values.frames import TactileFrame

_LOOKED_AT = 8  # presses
_SHARES = (0.45, 0.6, 0.75)
_AS_WIDE = 1.08  # times a contact's circle: balls on simulated gels 0.96, on a real Mini 1.03, on a GelSlim 3 1.16


def calibrate_sensor(
    images: Sequence[Image],
    reference: Image,
    sensor: SensorSpec,
    diameter_mm: float,
    *,
    pixel_mm: float | None = None,
    progress: Progress = SILENT,
    seed: int = 0,
) -> Calibration:
    """`calibrate_balls`, which keeps the built-in look-up unless presses better what the stage makes of it."""
    plain = make_built_in(sensor)
    if pixel_mm is not None:
        plain = replace(plain, pixel_mm=pixel_mm)

    def read_slopes(index: int) -> tuple[Floats, Floats]:
        frame = TactileFrame(sensor=sensor.name, image=images[index], reference=reference, index=index)
        return compute_slopes(estimate_depth(frame, sensor, plain, DepthParams()).indentation_mm, plain.pixel_mm)

    found = calibrate_balls(
        images, reference, sensor, diameter_mm, pixel_mm=pixel_mm, progress=progress, seed=seed, read_slopes=read_slopes
    )
    return found if found.uses_built_in else fit_contact_limit(found, images, reference, sensor)


def fit_contact_limit(found: Calibration, images: Sequence[Image], reference: Image, sensor: SensorSpec) -> Calibration:
    """The look-up with the share of the usual pressure at which contacts end on this gel.

    Skin or coating that bridges the gel beside a ball looks as if it pressed there: where contacts of the presses come
    out wider than their circles, the least share by which they do not is taken.
    """
    fits = [fit for fit in found.presses if fit.used]
    fits = fits[:: max(1, len(fits) // _LOOKED_AT)]

    def measure_width_ratio(look_up: Calibration) -> float:
        widths: list[float] = []
        for fit in fits:
            frame = TactileFrame(sensor=sensor.name, image=images[fit.index], reference=reference, index=fit.index)
            area = np.count_nonzero(estimate_depth(frame, sensor, look_up, DepthParams()).contact)
            widths.append(math.sqrt(area / math.pi) / fit.radius_px)
        return float(np.median(widths))

    for share in (None, *_SHARES):
        look_up = replace(found, median_pressure_share=share)
        if measure_width_ratio(look_up) <= (_AS_WIDE if share is None else 1.0):
            return look_up
    return replace(found, median_pressure_share=_SHARES[-1])
