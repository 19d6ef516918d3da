"""Depth of a bubble: its depth image itself, filled, denoised, and compared with the untouched one."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Floats, Mask, freeze
from pipeline.base.errors import ShapeError
from pipeline.base.stage_warnings import AT_BORDER, StageWarning
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth import bubble_contact
from pipeline.stages.depth.bubble_network_input import estimate_rest_surface
from pipeline.values.frames import TactileFrame
from pipeline.values.pixel_index import make_pixel_index
from pipeline.values.results import DepthMap

_BLOCK_PX = 8
_FEWEST_READINGS = 0.5  # share of pixels with a reading below which a frame is not called untouched
_GAP_PX = 3.0  # reach of the filling
_FEWEST_AROUND = 0.15  # share of readings, weighted by that reach, from which a gap is filled
_MANY_WILD = 0.02  # of the pixels: fewer are filled in without harm
_FARTHEST = 3.0  # times the median rest depth: beyond any membrane
_BULGE_MM, _BULGE_SHARE = 1.0, 0.5  # outward, and of what is pushed in: a pressed bubble bulges by a fifth of it
_MOST_BLOCKS = 0.99  # the block of which this share moves less; a few are wild


def describe_if_no_contact(image: NDArray[Any], reference: NDArray[Any], limit_mm: float) -> tuple[str, ...] | None:
    """The notes of a frame without contact; None where there may be contact."""
    return ("nothing touches the sensor",) if compute_largest_change(image, reference) < limit_mm else None


def compute_largest_change(image: NDArray[Any], reference: NDArray[Any]) -> float:
    """Largest mean absolute change of a block in mm over the pixels that have a reading; infinite if too few have."""
    import cv2

    with np.errstate(invalid="ignore", over="ignore"):
        some = reference[::_BLOCK_PX, ::_BLOCK_PX]
        some = some[some > 0]
        if not some.size:
            return math.inf
        near = _FARTHEST * float(np.median(some))
        seen = ((image > 0) & (reference > 0) & (image < near) & (reference < near)).astype(np.float32)
    if float(seen.mean()) < _FEWEST_READINGS:
        return math.inf
    change = np.where(seen > 0, reference - image, 0.0).astype(np.float32)
    size = (max(1, image.shape[1] // _BLOCK_PX), max(1, image.shape[0] // _BLOCK_PX))
    total = np.asarray(cv2.resize(change, size, interpolation=cv2.INTER_AREA))
    share = np.asarray(cv2.resize(seen, size, interpolation=cv2.INTER_AREA))
    return float(np.abs(total / np.maximum(share, 0.25)).max())


def estimate_depth(frame: TactileFrame, source: SensorSpec, *, smoothing_px: float, least_mm: float) -> DepthMap:
    """The depth of one bubble frame, see `pipeline.stages.depth.depth`; the frame has been checked there.

    Rest is the reference depth without its noise, so that no shape of the bubble is assumed; with `smoothing_px` 0 it
    is the reference itself. Small gaps are filled; where there is no reading for more than a few pixels around,
    indentation and depth are NaN.
    """
    if frame.reference is None:
        raise ShapeError("a bubble's depth needs a reference depth image")
    notes: list[str] = []
    moved, rest, read, seen = compute_displacement(
        frame.reference, frame.image, source.limits.indentation_max_mm, notes
    )
    indentation, touched = bubble_contact.estimate_indentation(
        moved, read, source, smoothing_px=smoothing_px, least_mm=least_mm
    )
    touched &= seen
    if smoothing_px > 0:
        rest = estimate_rest_surface(rest, read, source.pixel_mm)  # its noise is no part of the membrane
    if not touched.any():
        notes.append("nothing touches the sensor")
    elif np.concatenate([touched[0], touched[-1], touched[:, 0], touched[:, -1]]).any():
        notes.append(AT_BORDER)
    nothing = np.float32(np.nan)
    return DepthMap(
        indentation_mm=freeze(np.where(seen, indentation, nothing)),
        depth_mm=freeze(np.where(seen, rest - indentation, nothing)),
        contact=freeze(touched),
        camera=source.camera,
        source_index=make_pixel_index(indentation.shape),
        notes=tuple(notes),
    )


def compute_displacement(
    rest_mm: NDArray[Any], now_mm: NDArray[Any], largest_mm: float, notes: list[str]
) -> tuple[Floats, Floats, Mask, Mask]:
    """(move, rest, where both were read, where the move is known) of two readings (rows, cols); small gaps are filled.

    The move is 0 where it is not known. What had to be left out or filled in is added to `notes`.
    """
    rest = rest_mm.astype(np.float32)
    moved, read = _difference(rest, now_mm.astype(np.float32), np.float32(largest_mm), notes)
    known, gaps = read, ~read
    if gaps.any():
        moved, known = fill_gaps(moved, read)
        rest, _ = fill_gaps(np.where(gaps, np.float32(0.0), rest), read)
        if n_filled := int((gaps & known).sum()):
            notes.append(f"{n_filled} pixels had no reading and were filled from around them")
        if not known.all():
            notes.append(f"{int((~known).sum())} pixels have no value: nothing was read there or close by")
    notes += _bulge(moved)
    return moved, rest, read, known


def _bulge(moved_mm: Floats) -> tuple[str, ...]:
    """What is said of a membrane (rows, cols) that stands farther out than air makes it."""
    import cv2

    size = (max(1, moved_mm.shape[1] // _BLOCK_PX), max(1, moved_mm.shape[0] // _BLOCK_PX))
    blocks = np.asarray(cv2.resize(moved_mm, size, interpolation=cv2.INTER_AREA))
    pushed, out = (float(np.quantile(way * blocks, _MOST_BLOCKS)) for way in (1.0, -1.0))
    if out <= max(_BULGE_MM, _BULGE_SHARE * pushed):
        return ()
    return (StageWarning(f"the membrane stands {out:.1f} mm farther out than untouched: "
                  "was the reference touched, or is the depth's sign flipped?"),)  # fmt: skip


def _difference(rest: Floats, now: Floats, largest: np.float32, notes: list[str]) -> tuple[Floats, Mask]:
    """(rest - now, where both are readings of the membrane); what jumps farther than the sensor can go is none."""
    with np.errstate(invalid="ignore", over="ignore"):
        seen = (rest > 0) & (now > 0)
        # Stereo cameras mark a failed match by an arbitrarily far value.
        seen &= rest < _FARTHEST * np.median(rest[rest > 0])
        moved = rest - now
        wild = seen & ~(np.abs(moved) <= largest)
    if wild.any():
        told = f"{int(wild.sum())} pixels jumped farther than the sensor's {largest:g} mm and were taken for no reading"
        notes.append(StageWarning(told) if wild.mean() > _MANY_WILD else told)
    seen &= ~wild
    return np.where(seen, moved, np.float32(0.0)), np.asarray(seen, np.bool_)


def fill_gaps(values: Floats, seen: Mask) -> tuple[Floats, Mask]:
    """(values, known): gaps take a Gaussian mean of the readings close by; `values` must be 0 in the gaps."""
    import cv2

    weight = seen.astype(np.float32)
    mean, total = (np.asarray(cv2.GaussianBlur(a, (0, 0), _GAP_PX), np.float32) for a in (values * weight, weight))
    ready = ~seen & (total > _FEWEST_AROUND)
    filled = np.where(ready, mean / np.maximum(total, np.float32(_FEWEST_AROUND)), values)
    return np.asarray(filled, np.float32), seen | ready
