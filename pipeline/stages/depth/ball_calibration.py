"""Calibration from presses of a ball, kept only where it beats the depth stage without calibration.

The uncalibrated stage knows more than the built-in table (it estimates the illumination), so its slopes of every press
are the baseline.
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

_PRESSES_MAX = 8  # used to fit the contact limit
_SHARES = (0.45, 0.6, 0.75)
_WIDTH_RATIO_MAX = (
    1.08  # of contact width to circle: balls on simulated gels 0.96, on a real Mini 1.03, on a GelSlim 3 1.16
)


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
    """The calibration of `calibrate_balls`; the built-in table where the presses do not improve on the stage."""
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
    """The calibration with the share of the median pressure at which contacts end on this gel.

    A skin or coating that bridges the gel next to a ball looks like pressure there: where contacts of the presses are
    wider than their circles, the smallest share that prevents it is taken.
    """
    fits = [fit for fit in found.presses if fit.used]
    fits = fits[:: max(1, len(fits) // _PRESSES_MAX)]

    def measure_width_ratio(look_up: Calibration) -> float:
        widths: list[float] = []
        for fit in fits:
            frame = TactileFrame(sensor=sensor.name, image=images[fit.index], reference=reference, index=fit.index)
            area = np.count_nonzero(estimate_depth(frame, sensor, look_up, DepthParams()).contact)
            widths.append(math.sqrt(area / math.pi) / fit.radius_px)
        return float(np.median(widths))

    for share in (None, *_SHARES):
        look_up = replace(found, median_pressure_share=share)
        if measure_width_ratio(look_up) <= (_WIDTH_RATIO_MAX if share is None else 1.0):
            return look_up
    return replace(found, median_pressure_share=_SHARES[-1])
