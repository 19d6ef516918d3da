"""Expected error of a gel's depth in contact, from the steepness of the touch and its illumination.

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

import numpy as np

from pipeline.calibration.calibration_table import USUAL_STD, Calibration
from pipeline.core.arrays import percentile
from pipeline.core.values.results import DepthErrorModel, DepthMap
from pipeline.physics.optics import compute_slopes
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth.illumination.light import Illumination

_UNEXPLAINED_FACTOR = 2.6
_STEEP_PERCENT = 95  # percentile of the slopes in contact
_STEEPNESS_RANGE = 0.2, 1.6  # mm/mm: range of those presses


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
        rms_mm = other_mm if illumination is None else _UNEXPLAINED_FACTOR * other_mm
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
    where = np.flatnonzero(depth.contact.any(axis=1)), np.flatnonzero(depth.contact.any(axis=0))
    here = tuple(slice(max(int(n[0]) - 1, 0), int(n[-1]) + 2) for n in where)
    steep = np.asarray(
        cv2.magnitude(*compute_slopes(depth.indentation_mm[here], pixel_mm)), np.float32
    )
    return float(np.clip(percentile(steep, _STEEP_PERCENT, depth.contact[here]), *_STEEPNESS_RANGE))
