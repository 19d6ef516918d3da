"""Difference images, which are frames minus their reference: the reference is restored from the sensor description.

Some training sets keep differences only, with mid-grey (or zero, in floats) for no change. Slopes follow from the
change relative to the reference brightness, so that a described reference is good enough.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Image, freeze
from pipeline.sensors.parts import compute_reference_light
from pipeline.sensors.spec import SensorSpec

MID_GREY = 128.0  # grey level
_MAX_FROM_MID_GREY = 16.0  # grey levels of a pixel without change
_MIN_QUIET_SHARE = 0.5  # of the pixels of a difference; at most a third of a gel's reference image is mid-grey
DIFFERENCE_NOTE = (
    "the images are differences from a reference (mid-grey or zero is no change); the reference follows from the "
    "sensor description, and a difference that was halved gives half the depth"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class ImpliedReference:
    """The reference image that differences imply."""

    reference: Image  # (rows, cols, 3)
    no_change_grey: float  # grey level of no change

    def restore_image(self, difference: NDArray[np.generic]) -> Image:
        """The frame (rows, cols, 3) uint8 whose difference this is."""
        image = self.reference.astype(np.float32) + difference.astype(np.float32) - np.float32(self.no_change_grey)
        return freeze(np.clip(np.rint(image), 0, 255).astype(np.uint8))


def estimate_no_change_grey(image: Image) -> float | None:
    """The grey level of no change in a difference image (rows, cols, 3); None for an image of a camera."""
    near = (np.abs(image.astype(np.float32) - MID_GREY) <= _MAX_FROM_MID_GREY).all(axis=2)
    return float(np.median(image[near])) if near.mean() > _MIN_QUIET_SHARE else None


def derive_implied_reference(
    spec: SensorSpec | None, shape: tuple[int, int], no_change_grey: float
) -> ImpliedReference:
    """The described reference image without markers; plain mid-grey where the sensor or its optics are not known."""
    if spec is None or spec.optics is None or spec.camera.shape != shape:
        light = np.full((*shape, 3), MID_GREY)
    else:
        light = np.clip(np.rint(compute_reference_light(spec.camera, spec.optics)), 0, 255)
    return ImpliedReference(reference=freeze(light.astype(np.uint8)), no_change_grey=no_change_grey)
