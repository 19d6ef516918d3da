"""Capture the reference image: the median of the last frames, compared with those that follow."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from pipeline.core.arrays import Floats, Image, freeze
from pipeline.io.reference_images import compute_block_means
from pipeline.sensors.spec import SensorSpec

MIN_FRAMES = 3
AUTO_CAPTURE_FRAMES = 7
MAX_FRAMES = 15
_BLOCKS_ALONG = 16  # along the longer side
# times the median change between two frames: the limit of motion if larger than `still_change`
_NOISE_FACTOR = 6.0
_CONTACT_QUANTILE = 0.98  # of the blocks: a touch covers at least the rest


def compute_median_image(images: Sequence[Image | Floats]) -> Image | Floats:
    """The median of images of one shape, in their own type; NaN only where most of them are NaN."""
    stack = np.stack(list(images))
    if stack.dtype == np.uint8:
        return freeze(np.rint(np.median(stack, axis=0)).astype(np.uint8))
    known = np.isfinite(stack)
    filled = np.where(
        known.any(axis=0), np.nanmedian(np.where(known, stack, np.nan), axis=0), np.nan
    )
    return freeze(np.where(known.sum(axis=0) * 2 > len(stack), filled, np.nan).astype(np.float32))


def check_motion(images: Sequence[Image | Floats], sensor: SensorSpec) -> str:
    """A warning if the sensor was touched or moved while these images were taken, else ""."""
    blocks = [compute_block_means(image, _BLOCKS_ALONG) for image in images]
    change = np.abs(blocks[-1] - blocks[0]).max(axis=-1)
    noise = float(np.median([np.median(np.abs(b - a)) for a, b in pairwise(blocks)] or [0.0]))
    if float(np.quantile(change, 0.99)) > max(
        sensor.sensor_kind.still_change, _NOISE_FACTOR * noise
    ):
        return (
            "something touched or moved the sensor while the reference was taken; leave it "
            "alone and set it again"
        )
    return ""


def check_new_contact(reference: Image | Floats, before: Image | Floats, sensor: SensorSpec) -> str:
    """A warning if a part of a new reference differs from the one before and the rest does not,
    else "".
    """
    if reference.shape != before.shape:
        return ""
    change = _compute_block_change(reference, before)
    if (
        float(np.quantile(change, _CONTACT_QUANTILE))
        > _drift_limit(sensor, 1.0)
        > float(np.median(change))
    ):
        return (
            "a part of the new reference has changed as by a touch; remove the object and set "
            "the reference again"
        )
    return ""


def check_drift(image: Image | Floats, reference: Image | Floats, sensor: SensorSpec) -> str:
    """A warning if most of the image differs from the reference, else "".

    A touch changes a part of the image. A change of more than half of it is one of light or of the
    sensor.
    """
    if image.shape != reference.shape:
        return "the reference has another size; set it again"
    change = float(np.median(_compute_block_change(image, reference)))
    unit = "mm" if sensor.sensor_kind.is_depth else "grey levels"
    too_large = change > _drift_limit(sensor, 2.0)
    return (
        f"most of the image is {change:.1f} {unit} from the reference; set it again"
        if too_large
        else ""
    )


def _drift_limit(sensor: SensorSpec, factor: float) -> float:
    """Limit of drift: fixed for the kind, else `factor` times the sensor's limit of a frame
    without contact.
    """
    fixed = sensor.sensor_kind.drift_change
    return factor * sensor.limits.no_contact_change if fixed is None else fixed


def _compute_block_change(image: Image | Floats, reference: Image | Floats) -> Floats:
    """Largest change over the channels of each block (block rows, block cols)."""
    return np.abs(
        compute_block_means(image, _BLOCKS_ALONG) - compute_block_means(reference, _BLOCKS_ALONG)
    ).max(axis=-1)
