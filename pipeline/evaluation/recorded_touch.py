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
from pipeline.networks.square_images import compute_change
from pipeline.sensors.spec import SensorSpec
from pipeline.values.frames import TactileFrame, Truth
from pipeline.values.results import GeneratedTouch

Region = Literal["all", "contact", "seen", "beyond"]
REGIONS: Mapping[Region, str] = {
    "all": "the whole picture", "contact": "where the target really is touched",
    "seen": "what the source could feel", "beyond": "the rest",
}  # fmt: skip
GREY_PEAK, BUBBLE_PEAK_MM = 255.0, 22.5  # of PSNR and similarity; a bubble's is the published one


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedTouch:
    """What the target recorded of a touch, and what is exactly known of it."""

    change: Floats  # (rows, cols, channels) brightness in shares of full, or the imprint in mm
    image: Doubles  # (rows, cols, channels) as similarity is taken of it
    reference: Doubles | None  # a gel's picture (rows, cols, 3) in grey
    indentation_mm: Floats
    contact: Mask
    kind: str

    @property
    def peak_value(self) -> float:
        """Largest value of a picture."""
        return GREY_PEAK if self.kind == "gel" else BUBBLE_PEAK_MM

    @property
    def noise_free_change(self) -> Floats:
        """The change without a depth camera's noise; a gel's as recorded, whose noise is a grey or two."""
        return self.change if self.kind == "gel" else self.indentation_mm[..., None]

    def compute_region_masks(self, known: Mask) -> dict[Region, Mask]:
        """Where each region is, of those that are not empty; `known` is what the source could feel."""
        every = np.ones(self.contact.shape, np.bool_)
        found: dict[Region, Mask] = {"all": every, "contact": self.contact, "seen": known, "beyond": ~known}
        return {name: mask for name, mask in found.items() if mask.any()}

    def render_image(self, changed: Floats) -> Doubles:
        """A change as this very unit would have pictured it."""
        if self.reference is None:
            return changed.astype(np.float64)
        return np.clip(self.reference + GREY_PEAK * changed.astype(np.float64), 0.0, GREY_PEAK)


def build_recorded_touch(frame: TactileFrame, truth: Truth | None) -> RecordedTouch:
    """What to compare with; raises SettingProblem where the recording lacks what that takes."""
    if truth is None or truth.indentation_mm is None or truth.contact is None or frame.reference is None:
        raise SettingProblem(
            f"frame {frame.index} has no untouched reading, or its truth is not known: not to score by"
        )
    return replace(build_without_truth(frame), indentation_mm=truth.indentation_mm, contact=truth.contact)


def build_without_truth(frame: TactileFrame) -> RecordedTouch:
    """The same of a touch of which nothing else is known: no indentation (NaN), no contact. Raises SettingProblem."""
    if frame.reference is None:
        raise SettingProblem(f"frame {frame.index} has no untouched reading to compare with; give --reference")
    kind = "bubble" if frame.is_depth else "gel"
    changed = compute_change(kind, frame.image, frame.reference)
    untouched = None if frame.is_depth else frame.reference.astype(np.float64)
    picture = changed.astype(np.float64) if untouched is None else frame.image.astype(np.float64)
    shape = frame.image.shape[:2]
    return RecordedTouch(
        change=changed, image=picture, reference=untouched, indentation_mm=np.full(shape, np.nan, np.float32),
        contact=np.zeros(shape, np.bool_), kind=kind,
    )  # fmt: skip


def compute_generated_change(touch: GeneratedTouch, target: SensorSpec) -> Floats:
    """The change (rows, cols, channels) that a generated touch is, from the described unit's untouched reading."""
    kind = "bubble" if target.sensor_kind.is_depth else "gel"
    return compute_change(kind, touch.image, target.render_reference())
