"""A gel's depth map: indentation within the sensor's range, expected error, and notes.

Expected error of a gel's depth in contact, from the steepness of the touch and its illumination.

Fitted to 706 simulated presses of four gels and eighteen objects, half of them on other sensor
instances than the described one. The error is proportional to the steepness (power 0.97; depth and
contact area add nothing then). LEDs as described give a third to a sixth of the error of LEDs
estimated from the touch (a sensor's description has both), and where no LEDs explain the image the
error is 2.6 times the latter. The residual of the log error has a standard deviation of 0.86, so
one touch in ten has more than three times the stated error, which is a median; the residual of the
image under the fitted light explains hardly more (0.81).

That is an error of shape. Where no usual LEDs explain the image, and with a calibration table, the
depth as a whole may be wrong by a factor as well: by as much as the calibration expects, or as
balls on real units show without one. Both add as variances.
"""

import math
from dataclasses import replace
from typing import cast

import numpy as np

from pipeline.calibration import quality_notes
from pipeline.calibration.calibration_table import USUAL_STD, Calibration
from pipeline.core.arrays import Floats, Image, Mask, percentile
from pipeline.core.errors import AT_BORDER, StageWarning, UncertainContact
from pipeline.core.values.frames import TactileFrame
from pipeline.core.values.results import DepthErrorModel, DepthMap, make_depth_map
from pipeline.physics.optics import compute_slopes
from pipeline.physics.reference_colours import compare_colours
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth.contact import find_box, reaches_border
from pipeline.stages.depth.gel.rest import RestState
from pipeline.stages.depth.gel.settings import CONTACT
from pipeline.stages.depth.illumination.light import Illumination

NOT_SCALED = (
    "the light is fitted to this touch: the depth scale of the calibration does not apply to it"
)


def make_gel_depth(
    indentation: Floats,
    touched: Mask,
    frame: TactileFrame,
    rest: RestState,
    notes: tuple[str, ...],
    *,
    calibration: Calibration | None = None,
    illumination: Illumination | None = None,
    mirroring: str = "",
) -> DepthMap:
    """A depth map of an indentation (rows, cols) in mm, which is cut to the sensor's range in
    place.

    `calibration` and `illumination` are what it was measured by; None where no light was needed.
    `mirroring` as `slopes.describe_mirroring` returns it. The first notes say how good the
    calibration is.
    """
    source = rest.source
    table = rest.calibration
    notes = (
        *rest.notes,
        *notes,
        *_limit_depth(indentation, touched, source.limits.indentation_max_mm),
    )
    depth = make_depth_map(source.rest_depth_mm, indentation, touched, source.camera, notes)
    error = predict_gel_error(depth, source, calibration or table, illumination)
    is_described = not table.presses or NOT_SCALED in notes
    quality = (
        quality_notes.UNCALIBRATED_NOTE if is_described else quality_notes.describe_quality(table)
    )
    mismatch = describe_reference_mismatch(frame, source) or mirroring
    odd = (
        (StageWarning(f"{mismatch}; depth and contact may be all wrong"),)
        if mismatch and table.is_built_in
        else ()
    )
    return replace(depth, error=error, notes=(quality, *odd, *notes))


def describe_reference_mismatch(frame: TactileFrame, source: SensorSpec) -> str:
    """How a gel's reference image differs from that of the sensor's description, as a clause.

    "" where it does not.
    """
    problem = compare_colours(cast("Image", frame.reference), source).problem
    return f"the reference image is not that of a {source.name}: {problem}" if problem else ""


def _limit_depth(indentation: Floats, touched: Mask, largest_mm: float) -> list[str]:
    """Cut the indentation (rows, cols) in place to the sensor's range.

    Returns notes on the range and the contact.
    """
    notes: list[str] = []
    beyond = indentation > largest_mm
    if beyond.any():
        cut = (
            f"{int(beyond.sum())} pixels were deeper than the sensor's {largest_mm:g} mm and "
            "were cut to that"
        )
        notes.append(StageWarning(cut))
        np.minimum(indentation, np.float32(largest_mm), out=indentation)
    if touched.sum() > CONTACT.full_share * touched.size:
        notes.append(
            StageWarning(
                "the contact fills the view: its depth is estimated from the little gel around it"
            )
        )
    elif reaches_border(touched):
        notes.append(AT_BORDER)
    if not touched.any() and indentation.any():
        notes.append(
            UncertainContact(
                "contact uncertain: the image has changed, but nothing presses hard enough"
            )
        )
    return notes


def predict_gel_error(
    depth: DepthMap, source: SensorSpec, calibration: Calibration, illumination: Illumination | None
) -> DepthErrorModel | None:
    """Expected error under an illumination (None: by the table alone).

    None where the sensor states no error.
    """
    limits = source.limits
    if not limits.depth_rms_mm:
        return None
    other_mm = limits.depth_rms_other_instance_mm or limits.depth_rms_mm
    if illumination is not None and illumination.model == "leds":
        rms_mm = other_mm if illumination.is_fitted_leds else limits.depth_rms_mm
    else:
        rms_mm = other_mm if illumination is None else CONTACT.unexplained_factor * other_mm
    shape_mm = _compute_steepness(depth, source.pixel_mm) * rms_mm
    scale_mm = get_scale_std(calibration, illumination) * _compute_rms_depth(depth)
    return DepthErrorModel(
        rms_mm=math.hypot(shape_mm, scale_mm), correlation_mm=limits.depth_correlation_mm
    )


def get_scale_std(calibration: Calibration, illumination: Illumination | None) -> float:
    """Relative standard deviation of the depth as a whole; 0 where usual LEDs explain the image."""
    if illumination is not None and illumination.is_trusted:
        return 0.0
    return USUAL_STD if calibration.expected_error is None else calibration.expected_error.depth_std


def _compute_rms_depth(depth: DepthMap) -> float:
    """Root mean square of the indentation in contact, mm; 0 without contact."""
    if not depth.contact.any():
        return 0.0
    return float(np.sqrt(np.mean(np.square(depth.indentation_mm[depth.contact], dtype=np.float64))))


def _compute_steepness(depth: DepthMap, pixel_mm: float) -> float:
    """The slope in contact (percentile, clipped), mm/mm; 1 without contact."""
    import cv2

    if not depth.contact.any():
        return 1.0
    here = find_box(depth.contact, 1)
    steep = np.asarray(
        cv2.magnitude(*compute_slopes(depth.indentation_mm[here], pixel_mm)), np.float32
    )
    return float(
        np.clip(
            percentile(steep, CONTACT.steep_percent, depth.contact[here]), *CONTACT.steepness_range
        )
    )
