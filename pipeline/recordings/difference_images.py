"""Pictures from which the untouched one has been taken away already: it is put back as the sensor's description has it.

Training sets keep differences only, with mid-grey (or zero, in floats) where nothing has changed. Slopes follow from
the change relative to the untouched brightness, so that a described picture in its place is worth having.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Image, freeze
from pipeline.sensors.reference_light import compute_reference_light
from pipeline.sensors.spec import SensorSpec

_MID_GREY, _NEAR_GREY = 128.0, 16.0
_QUIET_SHARE = 0.5  # of a difference's pixels that have not changed; of untouched gels at most a third are mid-grey
DIFFERENCE_NOTE = (
    "the pictures are differences from the untouched one (mid-grey or zero where nothing changed); that one is taken "
    "as the sensor's description has it, and a difference that was halved gives half the depth"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class ImpliedReference:
    """The untouched picture that differences stand for."""

    reference: Image
    no_change_grey: float  # grey level of no change

    def restore_image(self, difference: NDArray[np.generic]) -> Image:
        """(rows, cols, 3) uint8 as the camera would have taken it."""
        changed = self.reference.astype(np.float32) + difference.astype(np.float32) - np.float32(self.no_change_grey)
        return freeze(np.clip(np.rint(changed), 0, 255).astype(np.uint8))


def estimate_no_change_grey(picture: Image) -> float | None:
    """The grey level of no change in a difference (rows, cols, 3); None for a picture as cameras take it."""
    near = (np.abs(picture.astype(np.float32) - _MID_GREY) <= _NEAR_GREY).all(axis=2)
    return float(np.median(picture[near])) if near.mean() > _QUIET_SHARE else None


def derive_implied_reference(spec: SensorSpec | None, shape: tuple[int, int], centre: float) -> ImpliedReference:
    """The described untouched picture, without markers; plain mid-grey where the sensor or its lights are not known."""
    if spec is None or spec.optics is None or spec.camera.shape != shape:
        return ImpliedReference(
            reference=freeze(np.full((*shape, 3), round(_MID_GREY), np.uint8)), no_change_grey=centre
        )
    light = np.clip(np.rint(compute_reference_light(spec.camera, spec.optics)), 0, 255)
    return ImpliedReference(reference=freeze(light.astype(np.uint8)), no_change_grey=centre)
