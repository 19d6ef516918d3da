"""Depth of a gel: colour change -> slopes -> surface -> contact, computed only around what has changed.

Drift of the light and of the camera is removed first (`drift`). Where the calibration table was derived from the
sensor's description, the surface is then corrected by rendering it in the frame's illumination (`illumination`).

Constants marked "chosen" were compared with values a third less and half as much again (`docs/experiments.md`): the
best of these remove 3 % of the error, the worst add 9 %.
"""

import math
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from pipeline.base.arrays import Floats, Image, Mask
from pipeline.base.errors import AT_BORDER, StageWarning, UncertainContact
from pipeline.base.progress import Progress
from pipeline.calibration import near_led_prior
from pipeline.calibration.calibration_table import Calibration, check_calibration, make_built_in
from pipeline.sensors.spec import Gel, SensorSpec
from pipeline.stages.depth import (
    change_detection,
    drift,
    instance_check,
    light_changes,
)
from pipeline.stages.depth.change_detection import ImageWindow
from pipeline.stages.depth.gel import contact
from pipeline.stages.depth.gel.contact import GelContact, MeasuredSurface
from pipeline.stages.depth.gel.contact_settings import CONTACT
from pipeline.stages.depth.illumination import frame_illumination, gel_surface
from pipeline.stages.depth.illumination.light import Illumination
from pipeline.stages.depth.poisson import Boundary
from pipeline.values.frames import TactileFrame
from pipeline.values.results import DepthMap, make_depth_map

_SATURATED_GREY = 254  # noise of one grey level moves what is clipped at 255 down to here
_MAX_SATURATED_SHARE = 0.01  # of the changed region; more is warned of
_FULL_SHARE = 0.9  # of the view: the contact leaves too little of the gel at rest
_USUAL_GEL = Gel(thickness_mm=2.0, youngs_kpa=120.0, poisson=0.48)  # of a sensor described without its gel
_WEAK_SHADING = StageWarning(
    "the LEDs hardly shade slopes where the sensor is touched: sizes and depths may be wrong by half; calibrate"
)
_NOT_COVERED = StageWarning("no indentation of the calibration covers this touch: it is measured without calibration")
_LIGHT_CHANGE = UncertainContact(
    "contact uncertain: the image has changed, but no dent explains it; it is taken for light, not for touch"
)
NOT_SCALED = "the light is fitted to this touch: the depth scale of the calibration does not apply to it"
_SHADOW_LEDS = "no usual LEDs explain the image: measured with low LEDs that cast shadows, fitted to this touch"


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredContact:
    """A gel's contact, and the light that its surface was measured by."""

    gel: GelContact
    illumination: Illumination | None  # None where the calibration table contains its own light


def measure_gel_depth(
    frame: TactileFrame,
    source: SensorSpec,
    calibration: Calibration,
    illumination: Illumination,
    *,
    no_touch_grey: float,
    least_mm: float,
    pressure_share: float,
    smoothing_px: float,
    boundary: Boundary,
    progress: Progress,
    draft: bool = False,
) -> tuple[DepthMap, MeasuredContact | None]:
    """The depth of one gel image in its illumination, and the surface it rests on; the frame has been checked.

    See `photometric.estimate_depth`. The surface is None where nothing has changed. A draft takes fewer iterations.
    """
    image, reference = cast("Image", frame.image), cast("Image", frame.reference)
    check_calibration(calibration, source.name, image)
    shape, pixel_mm = source.camera.shape, calibration.pixel_mm
    indentation, touched = np.zeros(shape, np.float32), np.zeros(shape, np.bool_)
    drifted = drift.apply_estimated_drift(image, reference)
    notes, measured = [*instance_check.check_sensor_instance(calibration, reference), *drifted.notes], None
    window = change_detection.detect_change(image, drifted.image_8bit, no_touch_grey, pixel_mm)
    if window is None:
        notes.append(drift.describe_no_contact(drifted))
    else:
        here = (window.rows, window.cols)
        notes += _warn_of_image(image[here], source, window)
        corner = (window.rows.start, window.cols.start)
        if not calibration.covers(window.changed, corner):
            notes.append(_NOT_COVERED)
            calibration = replace(
                make_built_in(source), pixel_mm=pixel_mm, median_pressure_share=calibration.median_pressure_share
            )
            illumination = frame_illumination.estimate_illumination(frame, source, calibration, progress)
        progress.step(0.35, "integrating slopes")
        changed = gel_surface.ChangedImage(
            image=image, reference=drifted, window=window, source=source, calibration=calibration,
            smoothing_px=smoothing_px, boundary=boundary,
        )  # fmt: skip
        surface = gel_surface.estimate_surface(changed, illumination, progress, draft=draft)
        used = illumination if gel_surface.uses_illumination(source, calibration) else None
        notes += _describe_illumination(used, len(frame.context_frames))
        if used is not None and used.is_bound_to_place:
            surface = surface * np.float32(calibration.compute_depth_scale(surface, corner))
        elif calibration.depth_scale_map is not None:
            notes.append(NOT_SCALED)
        found = MeasuredSurface(
            surface_mm=surface, changed=window.changed, weight=window.blend_weight, rows=window.rows, cols=window.cols,
            shape=shape, pixel_mm=pixel_mm, gel=source.gel or _USUAL_GEL,
        )  # fmt: skip
        region = contact.detect_contact(found, CONTACT, calibration.median_pressure_share or pressure_share)
        progress.step(0.8, "relaxing the gel around the contact")
        gel, pressed = (
            contact.press_surface(found, region, region.contact, CONTACT, least_mm),
            np.zeros(shape, np.bool_),
        )
        if gel.explained_share >= CONTACT.explained_min:
            pressed[here] = light_changes.remove_light_changes(region.contact[here], surface, changed, used)
        if region.contact.any() and not pressed.any():
            notes.append(_LIGHT_CHANGE)
        else:
            if not np.array_equal(pressed, region.contact):
                gel = contact.press_surface(found, region, pressed, CONTACT, least_mm)
            touched, indentation = gel.contact.copy(), gel.compute_indentation(gel.contact).copy()
            measured = MeasuredContact(gel=gel, illumination=used)
        by_near_leds = used is not None and used.model in {"field", "near"}
        if by_near_leds and near_led_prior.has_weak_shading(touched, drifted.image, source):
            notes.append(_WEAK_SHADING)
        notes += _limit_depth(indentation, touched, source.limits.indentation_max_mm)
    progress.step(1.0, "depth is ready")
    return make_depth_map(source.rest_depth_mm, indentation, touched, source.camera, tuple(notes)), measured


def describe_if_no_contact(image: Image, reference: Image, no_touch_grey: float) -> tuple[str, ...] | None:
    """Notes on an image that differs from its reference by drift alone; None where something else has changed."""
    change = change_detection.compute_largest_change(image, reference)
    if change < no_touch_grey:
        return ("nothing touches the sensor",)
    if not math.isfinite(change):
        return None
    drifted = drift.apply_estimated_drift(image, reference)
    if drifted.drift is None or not change_detection.compute_largest_change(image, drifted.image_8bit) < no_touch_grey:
        return None
    return (*drifted.notes, drift.describe_no_contact(drifted))


def _describe_illumination(illumination: Illumination | None, n_context_frames: int) -> list[str]:
    """Notes on fitted LEDs."""
    if illumination is None:
        return []
    if illumination.is_fitted_leds:
        to = f"{n_context_frames} touches of the recording" if illumination.from_context else "this touch"
        return [f"measured with this sensor's LEDs, fitted to {to}"]
    return [_SHADOW_LEDS] if illumination.model == "shadow_leds" else []


def _warn_of_image(part: Image, source: SensorSpec, window: ImageWindow) -> list[str]:
    """Notes on slopes that the image does not show: under markers, and where it is saturated."""
    import cv2

    notes: list[str] = []
    if source.markers is not None:
        notes.append("slopes under the printed markers were filled in from around them")
    red, green, blue = cv2.split(part)
    clipped = np.asarray(cv2.max(cv2.max(red, green), blue)) >= _SATURATED_GREY
    share = np.count_nonzero(clipped & window.changed) / np.count_nonzero(window.changed)
    if share > _MAX_SATURATED_SHARE:
        notes.append(StageWarning(f"{share:.0%} of the touch is saturated: slopes there may be wrong; expose less"))
    return notes


def _limit_depth(indentation: Floats, touched: Mask, largest_mm: float) -> list[str]:
    """Cut the indentation (rows, cols) in place to the sensor's range; returns notes on the range and the contact."""
    notes: list[str] = []
    beyond = indentation > largest_mm
    if beyond.any():
        cut = f"{int(beyond.sum())} pixels were deeper than the sensor's {largest_mm:g} mm and were cut to that"
        notes.append(StageWarning(cut))
        np.minimum(indentation, np.float32(largest_mm), out=indentation)
    edge = np.concatenate([touched[0], touched[-1], touched[:, 0], touched[:, -1]])
    if touched.sum() > _FULL_SHARE * touched.size:
        notes.append(StageWarning("the contact fills the view: its depth is estimated from the little gel around it"))
    elif edge.any():
        notes.append(AT_BORDER)
    if not touched.any() and indentation.any():
        notes.append(UncertainContact("contact uncertain: the image has changed, but nothing presses hard enough"))
    return notes
