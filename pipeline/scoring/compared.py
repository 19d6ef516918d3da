"""A generated touch beside the one that was recorded, in the terms that all figures are taken in.

Both are changes of a sensor's reading: a gel's picture less its untouched one, a bubble's imprint. Two units of a
sensor are printed and lit differently, and whoever generates a touch knows the described unit alone; for similarity the
change is therefore put onto the recorded unit's own untouched picture.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from pipeline.base.arrays import Doubles, Floats, Mask
from pipeline.base.errors import SettingProblem
from pipeline.networks.squares import Kind, change
from pipeline.physics import optics
from pipeline.sensors.spec import SensorSpec
from pipeline.values.frames import TactileFrame, Truth
from pipeline.values.results import Touch

Region = Literal["all", "contact", "seen", "beyond"]
REGIONS: Mapping[Region, str] = {
    "all": "the whole picture", "contact": "where the target really is touched",
    "seen": "what the source could feel", "beyond": "the rest",
}  # fmt: skip
GREY_PEAK, BUBBLE_PEAK_MM = 255.0, 22.5  # of PSNR and similarity; a bubble's is the published one


@dataclass(frozen=True, slots=True, kw_only=True)
class Recorded:
    """What the target recorded of a touch, and what is exactly known of it."""

    change: Floats  # (rows, cols, channels) brightness in shares of full, or the imprint in mm
    picture: Doubles  # (rows, cols, channels) as similarity is taken of it
    untouched: Doubles | None  # a gel's picture (rows, cols, 3) in grey
    indentation_mm: Floats
    contact: Mask
    kind: Kind

    @property
    def peak(self) -> float:
        """Largest value of a picture."""
        return GREY_PEAK if self.kind == "gel" else BUBBLE_PEAK_MM

    @property
    def exact(self) -> Floats:
        """The change without a depth camera's noise; a gel's as recorded, whose noise is a grey or two."""
        return self.change if self.kind == "gel" else self.indentation_mm[..., None]

    def regions(self, known: Mask) -> dict[Region, Mask]:
        """Where each region is, of those that are not empty; `known` is what the source could feel."""
        every = np.ones(self.contact.shape, np.bool_)
        found: dict[Region, Mask] = {"all": every, "contact": self.contact, "seen": known, "beyond": ~known}
        return {name: mask for name, mask in found.items() if mask.any()}

    def picture_of(self, changed: Floats) -> Doubles:
        """A change as this very unit would have pictured it."""
        if self.untouched is None:
            return changed.astype(np.float64)
        return np.clip(self.untouched + GREY_PEAK * changed.astype(np.float64), 0.0, GREY_PEAK)


def recorded(frame: TactileFrame, truth: Truth | None) -> Recorded:
    """What to compare with; raises SettingProblem where the recording lacks what that takes."""
    if truth is None or truth.indentation_mm is None or truth.contact is None or frame.reference is None:
        raise SettingProblem(
            f"frame {frame.index} has no untouched reading, or its truth is not known: not to score by"
        )
    return replace(recorded_only(frame), indentation_mm=truth.indentation_mm, contact=truth.contact)


def recorded_only(frame: TactileFrame) -> Recorded:
    """The same of a touch of which nothing else is known: no indentation (NaN), no contact. Raises SettingProblem."""
    if frame.reference is None:
        raise SettingProblem(f"frame {frame.index} has no untouched reading to compare with; give --reference")
    kind: Kind = "bubble" if frame.is_depth else "gel"
    changed = change(kind, frame.image, frame.reference)
    untouched = None if frame.is_depth else frame.reference.astype(np.float64)
    picture = changed.astype(np.float64) if untouched is None else frame.image.astype(np.float64)
    shape = frame.image.shape[:2]
    return Recorded(
        change=changed, picture=picture, untouched=untouched, indentation_mm=np.full(shape, np.nan, np.float32),
        contact=np.zeros(shape, np.bool_), kind=kind,
    )  # fmt: skip


def generated(touch: Touch, target: SensorSpec) -> Floats:
    """The change (rows, cols, channels) that a generated touch is, from the described unit's untouched reading."""
    if target.kind == "gel":
        return change("gel", touch.image, optics.untouched(target))
    return change("bubble", touch.image, target.rest_depth_mm)
