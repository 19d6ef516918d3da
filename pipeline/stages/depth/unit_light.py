"""The light of a recording's unit, fitted once to several of its touches and kept: every frame is read by it."""

from __future__ import annotations

from dataclasses import dataclass, replace

from pipeline.base.arrays import Image
from pipeline.base.memo import Memo
from pipeline.base.progress import Progress
from pipeline.engine.digests import content
from pipeline.sensors.parts import Optics
from pipeline.stages.depth import drift, gel_light, lit_surface, moved, own_lamps
from pipeline.stages.depth.lit_surface import Changed

_SMOOTHING_PX = 1.0
_FEWEST = 2  # touches: one tells no more than a frame of itself


@dataclass(frozen=True, slots=True, kw_only=True)
class _Known:
    optics: Optics | None  # None = no usual unit's explain the pictures


def fitted(touches: tuple[Image, ...], reference: Image, like: Changed, progress: Progress) -> Optics | None:
    """The optics of the unit that took these pictures (rows, cols, 3); None where no usual unit's explain them.

    They are looked at by the sensor and the look-up of `like`. The same whoever asks first, and however a frame is
    looked at: of the pictures alone, kept by their content.
    """
    if len(touches) < _FEWEST or not gel_light.applies(like.source, like.calibration):
        return None
    pixel_mm = like.calibration.pixel_mm

    def make() -> _Known:
        found: list[own_lamps.Touch] = []
        for image in touches:
            still = drift.stilled(image, reference)
            window = moved.window(image, still.grey, like.source.limits.no_touch, pixel_mm)
            if window is not None:
                there = replace(
                    like, image=image, still=still, window=window, smoothing_px=_SMOOTHING_PX, boundary="flat"
                )
                found.append(lit_surface.touch(there, progress))
        return _Known(optics=own_lamps.fitted(like.source, found) if len(found) >= _FEWEST else None)

    return _kept.of((content(touches), content(reference), content(like.source), pixel_mm), make).optics


_kept: Memo[tuple[object, ...], _Known] = Memo(8)
