"""Depth of a bubble: its depth image itself, filled, denoised, and compared with the untouched one."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline import contact
from pipeline.arrays import Floats, Mask, freeze
from pipeline.errors import ShapeError
from pipeline.frames import TactileFrame
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.pixel_index import pixel_index
from pipeline.stages.results import DepthMap

_BLOCK_PX = 8
_FEWEST_READINGS = 0.5  # share of pixels with a reading below which a frame is not called untouched
_SPECKLE_PX = 5  # of the median that removes single wrong readings
_SPECK_MM2 = 8.0


def largest_change(image: NDArray[Any], reference: NDArray[Any]) -> float:
    """Largest mean absolute change of a block in mm over the pixels that have a reading; infinite if too few have."""
    import cv2

    seen = ((image > 0) & (reference > 0)).astype(np.float32)
    if float(seen.mean()) < _FEWEST_READINGS:
        return math.inf
    change = np.where(seen > 0, reference - image, 0.0).astype(np.float32)
    size = (max(1, image.shape[1] // _BLOCK_PX), max(1, image.shape[0] // _BLOCK_PX))
    total = np.asarray(cv2.resize(change, size, interpolation=cv2.INTER_AREA))
    share = np.asarray(cv2.resize(seen, size, interpolation=cv2.INTER_AREA))
    return float(np.abs(total / np.maximum(share, 0.25)).max())


def depth(frame: TactileFrame, source: SensorSpec, *, smoothing_px: float, least_mm: float) -> DepthMap:
    """The depth of one bubble frame, see `pipeline.stages.depth.depth`; the frame has been checked there.

    Rest is the reference depth itself, so that no shape of the bubble is assumed.
    """
    if frame.reference is None:
        raise ShapeError("a bubble's depth needs a reference depth image")
    notes: list[str] = []
    rest, now = (
        _filled(a.astype(np.float32), what, notes)
        for a, what in ((frame.reference, "reference"), (frame.image, "frame"))
    )
    raw = rest - now
    indentation = _denoised(raw, smoothing_px)
    largest = source.limits.indentation_max_mm
    beyond = indentation > largest
    if beyond.any():
        notes.append(f"{int(beyond.sum())} pixels were deeper than the sensor's {largest:g} mm and were cut to that")
        indentation = np.minimum(indentation, np.float32(largest))
    touched = _touched(indentation, least_mm, source.pixel_mm)
    if not touched.any():
        notes.append("nothing touches the sensor")
    elif np.concatenate([touched[0], touched[-1], touched[:, 0], touched[:, -1]]).any():
        notes.append("the contact reaches the image border: what lies beyond is not seen")
    return DepthMap(
        indentation_mm=freeze(indentation),
        depth_mm=freeze(np.asarray(rest - indentation, np.float32)),
        contact=freeze(touched),
        camera=source.camera,
        source_index=pixel_index(indentation.shape),
        notes=tuple(notes),
    )


def _filled(depth_mm: Floats, what: str, notes: list[str]) -> Floats:
    """Pixels without a reading take a Gaussian mean of the readings around; wider means where a narrower sees none."""
    import cv2

    seen = np.isfinite(depth_mm) & (depth_mm > 0)
    if seen.all():
        return depth_mm
    notes.append(f"{int((~seen).sum())} pixels of the {what} have no reading and were filled from around them")
    out = np.where(seen, depth_mm, np.float32(0.0))
    values, weight, todo = out.copy(), seen.astype(np.float32), ~seen
    reach = 2.0
    while todo.any() and reach < max(depth_mm.shape):
        mean, total = (np.asarray(cv2.GaussianBlur(a, (0, 0), reach), np.float32) for a in (values, weight))
        ready = todo & (total > 0.02)
        out[ready] = mean[ready] / total[ready]
        todo &= ~ready
        reach *= 3.0
    out[todo] = float(np.median(depth_mm[seen]))
    return out


def _denoised(raw: Floats, smoothing_px: float) -> Floats:
    """Speckle out by a median, then a blur that keeps edges (guided by the median itself)."""
    import cv2

    if smoothing_px <= 0:
        return raw.copy()
    calm = np.asarray(cv2.medianBlur(raw, _SPECKLE_PX), np.float32)
    radius = math.ceil(3 * smoothing_px)
    return np.asarray(cv2.bilateralFilter(calm, 2 * radius + 1, 1.0, 1.5 * smoothing_px), np.float32)


def _touched(indentation: Floats, least_mm: float, pixel_mm: float) -> Mask:
    pressed = contact.touched(indentation, least_mm=least_mm, pressure_share=0.1, smoothing_px=3.0)
    return contact.without_specks(pressed, max(4, round(_SPECK_MM2 / pixel_mm**2)))
