"""The recorded touch that generated touches are compared with, in the quantities of all metrics.

Touches are compared as changes from the reference: a gel's image less its reference image, a
bubble's imprint. Markers and illumination differ between sensor instances, and a generated touch is
of the described instance. Image similarity is therefore computed on the change added to the
recorded instance's reference image.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from pipeline.core.arrays import Doubles, Floats, Mask
from pipeline.core.errors import SettingProblem
from pipeline.core.values.frames import TactileFrame, Truth
from pipeline.core.values.results import GeneratedTouch
from pipeline.physics.sensor_images import render_reference
from pipeline.sensors.spec import SensorSpec

Region = Literal["all", "contact", "visible", "outside"]
REGIONS: Mapping[Region, str] = {
    "all": "the whole image",
    "contact": "true contact",
    "visible": "visible to the source",
    "outside": "outside the source's view",
}
GREY_PEAK = 255.0


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedTouch:
    """The target's frame of a touch with its ground truth."""

    change: Floats  # (rows, cols, channels) brightness as a share of full scale, or imprint in mm
    image: Doubles  # (rows, cols, channels) for image similarity
    reference: Doubles | None  # reference image of a gel (rows, cols, 3) in grey levels
    indentation_mm: Floats
    contact: Mask
    is_depth: bool
    peak_value: float  # of an image, for PSNR and SSIM

    @property
    def noise_free_change(self) -> Floats:
        """The change without depth camera noise.

        A gel's as recorded, with a noise of 1 to 2 grey levels.
        """
        return self.indentation_mm[..., None] if self.is_depth else self.change

    def compute_region_masks(self, known: Mask) -> dict[Region, Mask]:
        """Masks (rows, cols) of the regions that are not empty.

        `known` is what is visible to the source.
        """
        every = np.ones(self.contact.shape, np.bool_)
        masks: dict[Region, Mask] = {
            "all": every,
            "contact": self.contact,
            "visible": known,
            "outside": ~known,
        }
        return {name: mask for name, mask in masks.items() if mask.any()}

    def render_image(self, changed: Floats) -> Doubles:
        """The image (rows, cols, channels) that this sensor instance records of a change."""
        if self.reference is None:
            return changed.astype(np.float64)
        return np.clip(self.reference + GREY_PEAK * changed.astype(np.float64), 0.0, GREY_PEAK)


def build_recorded_touch(
    frame: TactileFrame, truth: Truth | None, sensor: SensorSpec
) -> RecordedTouch:
    """Recorded touch with ground truth; raises SettingProblem without reference or ground truth."""
    if (
        truth is None
        or truth.indentation_mm is None
        or truth.contact is None
        or frame.reference is None
    ):
        raise SettingProblem(
            f"frame {frame.index} has no reference or no ground truth and cannot be scored"
        )
    return replace(
        build_without_truth(frame, sensor),
        indentation_mm=truth.indentation_mm,
        contact=truth.contact,
    )


def build_without_truth(frame: TactileFrame, sensor: SensorSpec) -> RecordedTouch:
    """Recorded touch without ground truth: indentation NaN, no contact. Raises SettingProblem
    without reference.
    """
    if frame.reference is None:
        raise SettingProblem(
            f"frame {frame.index} has no reference to compare with; give --reference"
        )
    change = sensor.sensor_kind.compute_relative_change(frame.image, frame.reference)
    reference = None if frame.is_depth else frame.reference.astype(np.float64)
    image = change.astype(np.float64) if reference is None else frame.image.astype(np.float64)
    shape = frame.image.shape[:2]
    return RecordedTouch(
        change=change,
        image=image,
        reference=reference,
        indentation_mm=np.full(shape, np.nan, np.float32),
        contact=np.zeros(shape, np.bool_),
        is_depth=frame.is_depth,
        peak_value=sensor.sensor_kind.peak_change,
    )


def compute_generated_change(touch: GeneratedTouch, target: SensorSpec) -> Floats:
    """Change (rows, cols, channels) of a generated touch from the described instance's
    reference.
    """
    return target.sensor_kind.compute_relative_change(touch.image, render_reference(target))
