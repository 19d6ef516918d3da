"""What a gel's depth is off by where it touches, by what is known of the very touch.

Of 706 simulated presses of four gels, eighteen objects, as many of other units as of the described one, the logarithm
of the error goes with that of how steep the touch is (to the power .97; how deep it is, or how much of the view it
covers, tells no more then), and with the light that it was read by: lamps that are as described err by a third to a
sixth of what lamps do that the touch has to tell (a sensor's description has both), and where no lamps explain the
picture the error is 2.6 times that. What is left of the logarithm scatters by .86, so that a touch in ten errs by three
times what is told, about the middle of them; what the light leaves of the picture tells hardly more of that (.81).
"""

from __future__ import annotations

import numpy as np

from pipeline.base.ranks import percentile
from pipeline.physics.slopes import compute_slopes
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth.illumination.light import Illumination
from pipeline.values.results import DepthErrorModel, DepthMap

_UNEXPLAINED = 2.6
_STEEP = 95  # percentile of the contact's slopes
_STEEPNESS = 0.2, 1.6  # mm/mm: what presses had


def predict_gel_error(found: DepthMap, source: SensorSpec, illumination: Illumination | None) -> DepthErrorModel | None:
    """The error of a gel's answer that was read by `light`, None for a look-up's own; None where it is not known."""
    limits = source.limits
    if not limits.depth_rms_mm:
        return None
    other_mm = limits.depth_rms_other_instance_mm or limits.depth_rms_mm
    if illumination is not None and illumination.model == "leds":
        rms_mm = other_mm if illumination.is_fitted_leds else limits.depth_rms_mm
    else:
        rms_mm = other_mm if illumination is None else _UNEXPLAINED * other_mm
    steep = _steepness(found, source.pixel_mm)
    return DepthErrorModel(rms_mm=steep * rms_mm, correlation_mm=limits.depth_correlation_mm)


def _steepness(found: DepthMap, pixel_mm: float) -> float:
    """How steep a touch is, mm/mm; 1 without a contact."""
    import cv2

    if not found.contact.any():
        return 1.0
    where = np.flatnonzero(found.contact.any(axis=1)), np.flatnonzero(found.contact.any(axis=0))
    here = tuple(slice(max(int(n[0]) - 1, 0), int(n[-1]) + 2) for n in where)
    steep = np.asarray(cv2.magnitude(*compute_slopes(found.indentation_mm[here], pixel_mm)), np.float32)
    return float(np.clip(percentile(steep, _STEEP, found.contact[here]), *_STEEPNESS))
