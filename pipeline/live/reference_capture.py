"""Set zero: the untouched reading is the median of the last ones, and is held against those that follow."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from pipeline.base.arrays import Doubles, Floats, Image, freeze
from pipeline.sensors.spec import SensorSpec

MIN_FRAMES, AUTO_CAPTURE_FRAMES, MAX_FRAMES = 3, 7, 15
_BLOCKS_ALONG = 16
_SAME_NOISES = 6.0  # times the usual change of a block between two readings, where that is more than the limit
_SAME = {"gel": 2.0, "bubble": 0.4}  # grey levels and mm that a block's mean may change while nothing happens
_DRIFT_BUBBLE_MM = 1.0
_TOUCHED = 0.98  # share of the blocks: a touch covers at least the rest


def compute_median_image(images: Sequence[Image | Floats]) -> Image | Floats:
    """The median of readings of one shape, in their own type; NaN only where most of them are."""
    stack = np.stack(list(images))
    if stack.dtype == np.uint8:
        return freeze(np.rint(np.median(stack, axis=0)).astype(np.uint8))
    known = np.isfinite(stack)
    filled = np.where(known.any(axis=0), np.nanmedian(np.where(known, stack, np.nan), axis=0), np.nan)
    return freeze(np.where(known.sum(axis=0) * 2 > len(stack), filled, np.nan).astype(np.float32))


def check_motion(images: Sequence[Image | Floats], sensor: SensorSpec) -> str:
    """Why these are no readings of an untouched sensor; "" where nothing moved while they were taken."""
    blocks = [_blocks(image) for image in images]
    moved = np.abs(blocks[-1] - blocks[0]).max(axis=-1)
    usual = float(np.median([np.median(np.abs(b - a)) for a, b in pairwise(blocks)] or [0.0]))
    if float(np.quantile(moved, 0.99)) > max(_SAME[sensor.kind], _SAME_NOISES * usual):
        return "something touched or moved while zero was set; leave the sensor alone and set zero again"
    return ""


def check_new_contact(reference: Image | Floats, before: Image | Floats, sensor: SensorSpec) -> str:
    """Why a new zero may hold a touch: a part of it is another than in the zero `before`, the rest is not; else ""."""
    if reference.shape != before.shape:
        return ""
    change = np.abs(_blocks(reference) - _blocks(before)).max(axis=-1)
    limit = sensor.limits.no_contact_change if sensor.kind == "gel" else _DRIFT_BUBBLE_MM
    if float(np.quantile(change, _TOUCHED)) > limit > float(np.median(change)):
        told = "a part of the picture is not what it was at the last zero, as where something touches"
        return f"{told}; take it away and set zero again"
    return ""


def check_drift(image: Image | Floats, reference: Image | Floats, sensor: SensorSpec) -> str:
    """Why the reference does not fit this reading any more, judged by most of the picture; "" where it does.

    A touch changes a part of the picture: where more than half of it is another one than when zero was set, the light
    or the unit is.
    """
    if image.shape != reference.shape:
        return "the untouched reading is of another size; set zero"
    change = float(np.median(np.abs(_blocks(image) - _blocks(reference)).max(axis=-1)))
    limit = 2.0 * sensor.limits.no_contact_change if sensor.kind == "gel" else _DRIFT_BUBBLE_MM
    unit = "grey levels" if sensor.kind == "gel" else "mm"
    return f"most of the picture is {change:.1f} {unit} from zero; set zero again" if change > limit else ""


def _blocks(image: Image | Floats) -> Doubles:
    """Means over blocks (rows, cols, channels)."""
    import cv2

    rows, cols = image.shape[:2]
    size = tuple(max(1, round(_BLOCKS_ALONG * n / max(rows, cols))) for n in (cols, rows))
    known = np.nan_to_num(np.asarray(image, np.float32))
    small = np.asarray(cv2.resize(known, size, interpolation=cv2.INTER_AREA), np.float64)
    return small[..., None] if small.ndim == 2 else small
