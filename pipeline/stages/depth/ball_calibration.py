"""A look-up from presses of a ball that is better than what the depth stage reads without any.

The stage knows more than the built-in look-up (`gel_light`), so that presses have to do better than the stage: it is
asked what it makes of every press.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from pipeline.base.arrays import Floats, Image
from pipeline.base.progress import SILENT, Progress
from pipeline.calibration.balls import calibrate_balls
from pipeline.calibration.lookup import Calibration, built_in
from pipeline.physics.slopes import slopes
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth.stage import DepthParams, depth
from pipeline.values.frames import TactileFrame


def calibrated(
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
    plain = built_in(sensor)
    if pixel_mm is not None:
        plain = replace(plain, pixel_mm=pixel_mm)

    def read(index: int) -> tuple[Floats, Floats]:
        frame = TactileFrame(sensor=sensor.name, image=images[index], reference=reference, index=index)
        return slopes(depth(frame, sensor, plain, DepthParams()).indentation_mm, plain.pixel_mm)

    return calibrate_balls(
        images, reference, sensor, diameter_mm, pixel_mm=pixel_mm, progress=progress, seed=seed, read=read
    )
