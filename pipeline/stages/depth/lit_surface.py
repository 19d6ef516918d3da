"""The surface of what has changed in a gel's picture, and the light that it is read by."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from pipeline.base.arrays import Floats, Image
from pipeline.base.errors import CalibrationError
from pipeline.base.progress import Progress
from pipeline.base.ranks import median
from pipeline.calibration.lookup import Calibration, slopes
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth import gel_light, own_lamps, own_light
from pipeline.stages.depth.drift import Still
from pipeline.stages.depth.gel_light import Seen
from pipeline.stages.depth.moved import Window
from pipeline.stages.depth.poisson import Boundary, Integrated, Sides, integrate


@dataclass(frozen=True, slots=True, kw_only=True)
class Changed:
    """A picture in which something has moved, and how it is looked at."""

    image: Image
    still: Still
    window: Window
    source: SensorSpec
    calibration: Calibration
    smoothing_px: float
    boundary: Boundary


def surface(
    changed: Changed, rounds: int, light: own_light.Told | None, progress: Progress
) -> tuple[Floats, own_light.Told | None]:
    """The surface of the window in mm, its rest still to be found, and the light that it was read by.

    It can be stopped at every round.
    """
    window, pixel_mm = changed.window, changed.calibration.pixel_mm

    def integrated(gx: Floats, gy: Floats) -> Floats:
        progress.step(0.6, "integrating slopes")
        return _integrated(gx, gy, changed, window, pixel_mm)

    if not gel_light.applies(changed.source, changed.calibration):
        return integrated(*_looked_up(changed)), None
    picture, small = _seen(changed)
    integrates = _integrates(changed, progress)
    guess = _guess(small, changed, integrates)
    found, light = own_light.best(guess, small, changed.source, integrates, rounds, light)
    if small is not picture:
        found = gel_light.finer(found, small.by, window.moved.shape)
        found = own_light.read_by(
            light, found, picture, changed.source, integrated, 1, steps=gel_light.FINE_STEPS
        )  # fmt: skip
    return found, light


def touch(changed: Changed, progress: Progress) -> own_lamps.Touch:
    """What the picture says of its unit's lamps; for a look-up to which the sensor's own light `applies`."""
    _, small = _seen(changed)
    integrates = _integrates(changed, progress)
    guess = _guess(small, changed, integrates)
    found, _ = gel_light.corrected(guess, small, changed.source, "even", integrates(small))
    return own_light.touch(found, small, changed.source, integrates)


def _seen(changed: Changed) -> tuple[Seen, Seen]:
    """The window at the picture's own pixels, and on the grid of the rounds."""
    picture = gel_light.seen(
        changed.image, changed.still.picture, changed.window, changed.smoothing_px, changed.source.markers,
        changed.calibration.pixel_mm,
    )  # fmt: skip
    return picture, gel_light.coarser(picture, changed.image.shape)


def _integrates(changed: Changed, progress: Progress) -> own_light.Integrates:
    def on(cells: Seen) -> Integrated:
        window = replace(changed.window, moved=cells.moved)

        def roughly(gx: Floats, gy: Floats) -> Floats:
            progress.step(0.4, "integrating slopes")
            return _integrated(gx, gy, changed, window, cells.pixel_mm)

        return roughly

    return on


def _guess(small: Seen, changed: Changed, integrates: own_light.Integrates) -> Floats:
    return integrates(small)(*_finite(*gel_light.rough_slopes(small, changed.calibration), changed.source))


def _looked_up(changed: Changed) -> tuple[Floats, Floats]:
    """The slopes of the window by the look-up alone."""
    window = changed.window
    here = (window.rows, window.cols)
    gx, gy = slopes(
        changed.calibration, changed.image[here], changed.still.picture[here], window.moved,
        (window.rows.start, window.cols.start), markers=changed.source.markers, smoothing_px=changed.smoothing_px,
    )  # fmt: skip
    return _finite(gx, gy, changed.source)


def _finite(gx: Floats, gy: Floats, source: SensorSpec) -> tuple[Floats, Floats]:
    if not math.isfinite(float(gx.sum()) + float(gy.sum())):
        raise CalibrationError(f"the look-up of {source.name} gives slopes that are no numbers; calibrate again")
    return gx, gy


def _integrated(gx: Floats, gy: Floats, changed: Changed, window: Window, pixel_mm: float) -> Floats:
    """The integrated indentations (..., rows, cols) of the window, level at their rest outside what has moved.

    A touch at the image border is free there: the gel beyond is not seen, and not known to be at rest.
    """
    rows, cols = changed.image.shape[:2]
    inside = (window.cols.start > 0, window.cols.stop < cols, window.rows.start > 0, window.rows.stop < rows)
    ends: list[Boundary] = [changed.boundary if held else "free" for held in inside]
    z = integrate(gx, gy, pixel_mm, Sides(*ends))
    outside = ~window.moved
    if not outside.any():
        return z - z.min(axis=(-2, -1), keepdims=True)
    images = z.reshape(-1, *z.shape[-2:])
    level = np.array([median(image, outside) for image in images], np.float32)
    return (images - level[:, None, None]).reshape(z.shape)
