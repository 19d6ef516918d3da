"""Depth of a bubble: its depth image, filled and denoised, against the reference."""

import math
from dataclasses import replace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from pipeline.calibration.calibration_table import Calibration
from pipeline.core.arrays import Floats, Mask, freeze
from pipeline.core.errors import AT_BORDER, StageWarning
from pipeline.core.graph import Skipped
from pipeline.core.progress import Progress
from pipeline.core.values.frames import TactileFrame
from pipeline.core.values.results import DepthErrorModel, DepthMap, make_depth_map
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth import bubble_contact
from pipeline.stages.depth.bubble_network_input import estimate_rest_surface
from pipeline.stages.depth.contact import reaches_border
from pipeline.stages.depth.depth_params import DepthParams
from pipeline.stages.depth.frame_checks import make_untouched_depth

_BLOCK_PX = 8
_MEASURED_SHARE_MIN = 0.5  # share of measured pixels below which a frame is not called untouched
_FILL_PX = 3.0  # standard deviation of the mean that fills gaps
_FILL_WEIGHT_MIN = 0.15  # share of measured pixels, in that mean, from which a gap is filled
_OUTLIER_WARNING_SHARE = 0.02  # of the pixels: fewer are filled without harm
_DEPTH_MAX_FACTOR = 3.0  # times the median reference depth: no membrane is farther
# limits of the outward bulge: absolute, and over the indentation; a pressed bubble bulges by a
# fifth of it
_BULGE_MM = 1.0
_BULGE_SHARE = 0.5
_BLOCK_QUANTILE = 0.99  # quantile of the blocks that stands for the largest: a few are outliers


def skip_without_contact(
    frame: TactileFrame, source: SensorSpec, params: DepthParams
) -> DepthMap | None:
    """The exact depth of a checked frame without contact; None where there may be contact."""
    change_mm = compute_largest_change(frame.image, cast("Floats", frame.reference))
    if change_mm >= source.limits.no_contact_change / params.sensitivity:
        return None
    return make_untouched_depth(frame, source, ("nothing touches the sensor",))


def compute_largest_change(image: NDArray[Any], reference: NDArray[Any]) -> float:
    """Largest mean absolute change of a block in mm over its measured pixels.

    Infinite if too few are measured.
    """
    import cv2

    with np.errstate(invalid="ignore", over="ignore"):
        some = reference[::_BLOCK_PX, ::_BLOCK_PX]
        some = some[some > 0]
        if not some.size:
            return math.inf
        near = _DEPTH_MAX_FACTOR * float(np.median(some))
        seen = ((image > 0) & (reference > 0) & (image < near) & (reference < near)).astype(
            np.float32
        )
    if float(seen.mean()) < _MEASURED_SHARE_MIN:
        return math.inf
    change = np.where(seen > 0, reference - image, 0.0).astype(np.float32)
    size = (max(1, image.shape[1] // _BLOCK_PX), max(1, image.shape[0] // _BLOCK_PX))
    total = np.asarray(cv2.resize(change, size, interpolation=cv2.INTER_AREA))
    share = np.asarray(cv2.resize(seen, size, interpolation=cv2.INTER_AREA))
    return float(np.abs(total / np.maximum(share, 0.25)).max())


def estimate_bubble_frame(
    frame: TactileFrame,
    source: SensorSpec,
    _calibration: Calibration | None,
    params: DepthParams,
    _progress: Progress,
) -> DepthMap | Skipped[DepthMap]:
    """Depth of a checked frame by parameters of the stage, with its error."""
    still = skip_without_contact(frame, source, params)
    if still is not None:
        return Skipped(output=still, reason=still.notes[0])
    least_mm = params.contact_limit * source.limits.contact_min_mm
    found = estimate_depth(frame, source, smoothing_px=params.smoothing_px, least_mm=least_mm)
    return replace(found, error=make_bubble_error(source))


def make_bubble_error(source: SensorSpec) -> DepthErrorModel | None:
    """Depth error in contact of a bubble sensor; None if not measured."""
    rms_mm = source.limits.depth_rms_mm
    return (
        DepthErrorModel(rms_mm=rms_mm, correlation_mm=source.limits.depth_correlation_mm)
        if rms_mm
        else None
    )


def estimate_depth(
    frame: TactileFrame, source: SensorSpec, *, smoothing_px: float, least_mm: float
) -> DepthMap:
    """The depth of one bubble frame that `check_frame` has accepted.

    The rest surface is the reference depth without its noise, so no shape of the bubble is assumed;
    with `smoothing_px` 0 it is the reference itself. Small gaps are filled; in larger ones
    indentation and depth are NaN.
    """
    assert frame.reference is not None  # checked
    notes: list[str] = []
    moved, rest, read, seen = compute_displacement(
        frame.reference, frame.image, source.limits.indentation_max_mm, notes
    )
    indentation, touched = bubble_contact.estimate_indentation(
        moved, read, source, smoothing_px=smoothing_px, least_mm=least_mm
    )
    touched &= seen
    if smoothing_px > 0:
        rest = estimate_rest_surface(rest, read, source.pixel_mm)  # without the reference's noise
    if not touched.any():
        notes.append("nothing touches the sensor")
    elif reaches_border(touched):
        notes.append(AT_BORDER)
    nothing = np.float32(np.nan)
    depth = make_depth_map(
        rest, np.where(seen, indentation, nothing), touched, source.camera, tuple(notes)
    )
    return replace(
        depth, measured_depth_mm=freeze(np.where(read, frame.image, nothing).astype(np.float32))
    )


def compute_displacement(
    rest_mm: NDArray[Any], now_mm: NDArray[Any], largest_mm: float, notes: list[str]
) -> tuple[Floats, Floats, Mask, Mask]:
    """(displacement, rest, measured, known) of a reference and a frame (rows, cols), small gaps
    filled.

    `measured`: both have a value; `known`: measured or filled; the displacement is 0 elsewhere.
    Appends to `notes` what was left out or filled.
    """
    rest = rest_mm.astype(np.float32)
    moved, read = _subtract_reference(
        rest, now_mm.astype(np.float32), np.float32(largest_mm), notes
    )
    known = read
    gaps = ~read
    if gaps.any():
        moved, known = fill_gaps(moved, read)
        rest, _ = fill_gaps(np.where(gaps, np.float32(0.0), rest), read)
        if n_filled := int((gaps & known).sum()):
            notes.append(
                f"{n_filled} pixels were not measured and were filled from their surroundings"
            )
        if not known.all():
            notes.append(
                f"{int((~known).sum())} pixels have no value: nothing was measured there or close "
                "by"
            )
    notes += _warn_of_bulge(moved)
    return moved, rest, read, known


def _warn_of_bulge(moved_mm: Floats) -> tuple[str, ...]:
    """A warning if the membrane (rows, cols) stands farther out than air makes it, else empty."""
    import cv2

    size = (max(1, moved_mm.shape[1] // _BLOCK_PX), max(1, moved_mm.shape[0] // _BLOCK_PX))
    blocks = np.asarray(cv2.resize(moved_mm, size, interpolation=cv2.INTER_AREA))
    pushed, out = (float(np.quantile(sign * blocks, _BLOCK_QUANTILE)) for sign in (1.0, -1.0))
    if out <= max(_BULGE_MM, _BULGE_SHARE * pushed):
        return ()
    return (
        StageWarning(
            f"the membrane is {out:.1f} mm farther out than the reference, "
            "so the depth may be wrong: check the reference and the sign of the depth"
        ),
    )


def _subtract_reference(
    rest: Floats, now: Floats, largest: np.float32, notes: list[str]
) -> tuple[Floats, Mask]:
    """(rest - now, where both measure the membrane).

    Larger jumps than the sensor allows are outliers.
    """
    with np.errstate(invalid="ignore", over="ignore"):
        seen = (rest > 0) & (now > 0)
        # Stereo cameras mark a failed match by an arbitrarily large value.
        seen &= rest < _DEPTH_MAX_FACTOR * np.median(rest[rest > 0])
        moved = rest - now
        outliers = seen & ~(np.abs(moved) <= largest)
    if outliers.any():
        text = (
            f"{int(outliers.sum())} pixels moved by more than the sensor's {largest:g} mm and "
            "were ignored"
        )
        notes.append(StageWarning(text) if outliers.mean() > _OUTLIER_WARNING_SHARE else text)
    seen &= ~outliers
    return np.where(seen, moved, np.float32(0.0)), np.asarray(seen, np.bool_)


def fill_gaps(values: Floats, seen: Mask) -> tuple[Floats, Mask]:
    """(values, known) with small gaps filled by a Gaussian mean; `values` must be 0 in the gaps."""
    import cv2

    weight = seen.astype(np.float32)
    mean, total = (
        np.asarray(cv2.GaussianBlur(a, (0, 0), _FILL_PX), np.float32)
        for a in (values * weight, weight)
    )
    ready = ~seen & (total > _FILL_WEIGHT_MIN)
    filled = np.where(ready, mean / np.maximum(total, np.float32(_FILL_WEIGHT_MIN)), values)
    return np.asarray(filled, np.float32), seen | ready
