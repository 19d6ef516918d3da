"""The light of a recording's unit, fitted once to several of its touches and kept: every frame is read by it.

It is kept on disk as well: the fit takes as long as reading several frames, and who opens a recording opens it again.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from pipeline.base.arrays import Doubles, Image, freeze
from pipeline.base.memo import Memo
from pipeline.base.progress import Progress
from pipeline.engine import disk_store
from pipeline.engine.digests import compute_cached_digest
from pipeline.physics import optics
from pipeline.sensors.parts import Led, Optics
from pipeline.stages.depth import change_detection, drift, gel_surface, led_calibration, surface_refinement
from pipeline.stages.depth.gel_surface import ChangedImage

_SMOOTHING_PX = 1.0
_FEWEST = 2  # touches: one tells no more than a frame of itself
_CODE = ("pipeline.stages.depth", "pipeline.calibration", "pipeline.physics", "pipeline.sensors")  # what it comes from


@dataclass(frozen=True, slots=True, kw_only=True)
class _Known:
    optics: Optics | None  # None = no usual unit's explain the pictures


def fit_recording_leds(
    touches: tuple[Image, ...], reference: Image, like: ChangedImage, progress: Progress
) -> Optics | None:
    """The optics of the unit that took these pictures (rows, cols, 3); None where no usual unit's explain them.

    They are looked at by the sensor and the look-up of `like`. The same whoever asks first, and however a frame is
    looked at: of the pictures alone, kept by their content.
    """
    if len(touches) < _FEWEST or not surface_refinement.is_applicable(like.source, like.calibration):
        return None
    described, pixel_mm = optics.require_optics(like.source), like.calibration.pixel_mm

    def fit_to_touches() -> _StoredOptics:
        found: list[led_calibration.LedObservation] = []
        for image in touches:
            still = drift.apply_estimated_drift(image, reference)
            window = change_detection.detect_change(
                image, still.image_8bit, like.source.limits.no_contact_change, pixel_mm
            )
            if window is not None:
                there = replace(
                    like, image=image, reference=still, window=window, smoothing_px=_SMOOTHING_PX, boundary="flat"
                )
                found.append(gel_surface.estimate_led_observation(there, progress))
        return _StoredOptics.from_optics(
            led_calibration.fit_leds(like.source, found) if len(found) >= _FEWEST else None
        )

    made_of = (
        compute_cached_digest(touches),
        compute_cached_digest(reference),
        compute_cached_digest(like.source),
        compute_cached_digest(like.calibration),
    )
    return _cache.get_or_make(
        made_of,
        lambda: _Known(
            optics=disk_store.load_or_make(_StoredOptics, made_of, _CODE, fit_to_touches, "lamps").to_optics(described)
        ),
    ).optics


@dataclass(frozen=True, slots=True, kw_only=True)
class _StoredOptics:
    """Optics as numbers that a file keeps."""

    leds: Doubles  # (n, 5) azimuth and elevation in degrees, colour; none where no usual unit's explain the pictures
    others: Doubles  # (m,) every number of `Optics` that stands alone

    @classmethod
    def from_optics(cls, found: Optics | None) -> _StoredOptics:
        """These optics, or that there are none."""
        if found is None:
            return cls(leds=freeze(np.empty((0, 5))), others=freeze(np.empty(0)))
        leds = np.array([(led.azimuth_deg, led.elevation_deg, *led.rgb) for led in found.leds], np.float64)
        return cls(leds=freeze(leds), others=freeze(np.array([getattr(found, name) for name in _NUMBERS], np.float64)))

    def to_optics(self, described: Optics) -> Optics | None:
        """The optics; what is no number is as described."""
        if not len(self.leds):
            return None
        lit = [Led(azimuth_deg=a, elevation_deg=e, rgb=(r, g, b)) for a, e, r, g, b in self.leds.tolist()]
        return replace(described, leds=tuple(lit), **dict(zip(_NUMBERS, self.others.tolist(), strict=True)))


_NUMBERS = tuple(f.name for f in fields(Optics) if f.type == "float")
_cache: Memo[tuple[object, ...], _Known] = Memo(8)
