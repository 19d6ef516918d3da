"""Depth of a gel: colour change -> slopes -> surface -> contact, computed only around what has changed.

What touches is decided first, and drift removed (`gel`). Where the calibration table was derived from the
sensor's description, the surface is then corrected by rendering it in the frame's illumination (`illumination`).

Constants marked "chosen" were compared with values a third less and half as much again (`docs/experiments.md`): the
best of these remove 3 % of the error, the worst add 9 %.
"""

from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from pipeline.base.arrays import Floats, Image, Mask, freeze
from pipeline.base.errors import AT_BORDER, UNCERTAIN_CONTACT, StageWarning, UncertainContact
from pipeline.base.progress import Progress
from pipeline.calibration import near_led_prior
from pipeline.calibration.calibration_table import Calibration, check_calibration, make_built_in
from pipeline.sensors.spec import Gel, SensorSpec
from pipeline.stages.depth import (
    change_detection,
    contact,
    false_contacts,
    instance_check,
    light_changes,
    rest_level,
)
from pipeline.stages.depth.change_detection import ImageWindow
from pipeline.stages.depth.gel import coarse_light, rest
from pipeline.stages.depth.gel.change import Change
from pipeline.stages.depth.illumination import frame_illumination, gel_surface
from pipeline.stages.depth.illumination.gel_surface import Observation
from pipeline.stages.depth.illumination.light import Illumination
from pipeline.stages.depth.poisson import Boundary
from pipeline.values.frames import TactileFrame
from pipeline.values.results import DepthMap, make_depth_map

_FADE_START, _FADE_END = 0.2, 0.6  # gel thicknesses from the contact, see `_relax_surface`
_FAR = 0.7  # gel thicknesses from the contact: the gel is neither indented nor pulled down there (`rest_level`)
# Contact of a coarse dent: load over its load-weighted mean, and depth over the deepest. Areas of soft balls are .8 to
# 1.1 of the true ones; without the second, faint load far from the dent makes some 1.4.
_LOAD_SHARE, _DENT_SHARE = 0.35, 0.15
_SATURATED_GREY = 254  # noise of one grey level moves what is clipped at 255 down to here
_MAX_SATURATED_SHARE = 0.01  # of the changed region; more is warned of
_PRESSURE_BLUR_PX = 1.5  # blur of the relative pressure that separates certain contact (chosen)
_CONTACT_BLUR_PX = 1.0
_PRESSURE_CELLS = 220  # of that pressure's grid, along the longer side
_CERTAIN_SLOPE, _CERTAIN_SHARE = 0.04, 0.1  # mm/mm, and of the peak: relative pressure that noise does not reach
_GRAIN_SHARE = 0.5  # of the peak: a speck with this much pressure is no noise
_SPECK_MM2 = 0.15  # smaller contacts are camera noise
_HOLE_MM2 = 0.5  # gaps that a rough ball or a book leaves between its threads (`benchmarks/real_things.py`)
_FULL_SHARE = 0.9  # of the view: the contact leaves too little of the gel at rest
_BORDER_GEL = 0.5  # gel thicknesses, within which the gel beyond the border affects what is visible
_WEAK_SHADING = StageWarning(
    "the LEDs hardly shade slopes where the sensor is touched: sizes and depths may be wrong by half; calibrate"
)
_SMOOTH_DENT = "the touch is wide and smooth: measured on blocks of the image, by the pressure that explains it"
_NOT_COVERED = StageWarning("no indentation of the calibration covers this touch: it is measured without calibration")
NOT_SCALED = "the light is fitted to this touch: the depth scale of the calibration does not apply to it"
_SHADOW_LEDS = "no usual LEDs explain the image: measured with low LEDs that cast shadows, fitted to this touch"


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredSurface:
    """A gel's surface as measured, before mechanics replace it away from the contact."""

    surface_mm: Floats  # (rows, cols) of the window
    window: ImageWindow
    source: SensorSpec
    pixel_mm: float
    illumination: Illumination | None  # None where the calibration table contains its own light

    def relax_outside_contact(self, touched: Mask, distance: Floats | None = None) -> Floats:
        """The indentation (rows, cols) in mm for the contact `touched` (rows, cols); zero outside the window.

        `distance` of the window's pixels from the contact, in gel thicknesses, is computed where it is None.
        """
        here = (self.window.rows, self.window.cols)
        indentation = np.zeros(touched.shape, np.float32)
        indentation[here] = _relax_surface(
            self.surface_mm, touched[here], distance, self.window, self.source, self.pixel_mm
        )
        return indentation


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
) -> tuple[DepthMap, MeasuredSurface | None]:
    """The depth of one gel image in its illumination, and the surface it rests on; the frame has been checked.

    See `photometric.estimate_depth`. The surface is None where nothing has changed. A draft takes fewer iterations.
    """
    image, reference = cast("Image", frame.image), cast("Image", frame.reference)
    check_calibration(calibration, source.name, image)
    shape, pixel_mm = source.camera.shape, calibration.pixel_mm
    seen = gel_surface.observe(image, reference, source, pixel_mm, frame.context_frames)
    notes: list[str] = [*instance_check.check_sensor_instance(calibration, reference), *seen.rest.notes]
    answer = _answer_without_light(seen, source, calibration, notes, least_mm)
    if answer is not None:
        progress.step(1.0, "depth is ready")
        return answer, None
    touched = np.zeros(shape, np.bool_)
    window = change_detection.detect_press(image, seen.rest.image_8bit, no_touch_grey, pixel_mm, seen.change.dent_mm)
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
        image=image, reference=seen.rest, window=window, source=source, calibration=calibration,
        smoothing_px=smoothing_px, boundary=boundary,
    )  # fmt: skip
    surface = gel_surface.estimate_surface(changed, illumination, progress, draft=draft)
    used = illumination if gel_surface.uses_illumination(source, calibration) else None
    notes += _describe_illumination(used, len(frame.context_frames))
    if used is not None and used.is_bound_to_place:
        surface = surface * np.float32(calibration.compute_depth_scale(surface, corner))
    elif calibration.depth_scale_map is not None:
        notes.append(NOT_SCALED)
    surface, inside = _level_surface(surface, window, source, pixel_mm)
    pressed = inside | contact.detect_contact(
        surface, pixel_mm, least_mm=least_mm, pressure_share=pressure_share, smoothing_px=_CONTACT_BLUR_PX,
        median_pressure_share=calibration.median_pressure_share or contact.MEDIAN_PRESSURE_SHARE,
    )  # fmt: skip
    pressed = contact.remove_specks(pressed & (window.changed | inside), max(4, round(_SPECK_MM2 / pixel_mm**2)))
    pressed = light_changes.remove_light_changes(pressed, surface, changed, used)
    border = np.pad(np.zeros((shape[0] - 2, shape[1] - 2), np.bool_), 1, constant_values=True)[here]
    pressed = false_contacts.remove_false_contacts(pressed, surface, pixel_mm, border, window.changed)
    pressed = contact.fill_small_holes(pressed, round(_HOLE_MM2 / pixel_mm**2))
    narrow_px = _BORDER_GEL * (0.0 if source.gel is None else source.gel.thickness_mm) / pixel_mm
    touched[here] = contact.remove_border_artifacts(pressed, surface, *here, shape, narrow_px)
    distance = None if source.gel is None else _compute_distance(touched[here], pixel_mm, source.gel)
    if used is not None and (used.is_trusted or used.model == "shadow_leds"):
        surface = _level_far_field(surface, touched[here], distance, window, source, pixel_mm)
    progress.step(0.8, "relaxing the gel around the contact")
    measured = MeasuredSurface(
        surface_mm=freeze(surface), window=window, source=source, pixel_mm=pixel_mm, illumination=used
    )  # fmt: skip
    indentation = measured.relax_outside_contact(touched, distance)
    by_near_leds = used is not None and used.model in {"field", "near"}
    if by_near_leds and near_led_prior.has_weak_shading(touched, seen.rest.image, source):
        notes.append(_WEAK_SHADING)
    notes += _limit_depth(indentation, touched, source.limits.indentation_max_mm)
    progress.step(1.0, "depth is ready")
    return make_depth_map(source.rest_depth_mm, indentation, touched, source.camera, tuple(notes)), measured


def _answer_without_light(
    seen: Observation, source: SensorSpec, calibration: Calibration, notes: list[str], least_mm: float
) -> DepthMap | None:
    """The depth of a frame without a press, or of a wide and smooth one; None for others."""
    shape = source.camera.shape
    indentation, touched = np.zeros(shape, np.float32), np.zeros(shape, np.bool_)
    if seen.change.verdict == "none":
        notes = [*notes, rest.describe_no_contact(seen.rest)]
    elif seen.change.verdict == "uncertain":
        notes = [*notes, UNCERTAIN_CONTACT]
    elif seen.change.is_smooth and gel_surface.uses_illumination(source, calibration):
        indentation, touched = _upsample_dent(seen.change, shape, least_mm)
        notes = [*notes, _SMOOTH_DENT, *_limit_depth(indentation, touched, source.limits.indentation_max_mm)]
    else:
        return None
    return make_depth_map(source.rest_depth_mm, indentation, touched, source.camera, tuple(notes))


def _upsample_dent(change: Change, shape: tuple[int, int], least_mm: float) -> tuple[Floats, Mask]:
    """(indentation in mm, contact) (rows, cols) of a coarse dent: contact is where it is loaded."""
    import cv2

    block = coarse_light.compute_block_px(shape)
    rows, cols = (n * block for n in change.load.shape)
    more = (0, shape[0] - rows, 0, shape[1] - cols)
    indentation, load = (
        cv2.copyMakeBorder(cv2.resize(a, (cols, rows), interpolation=cv2.INTER_CUBIC), *more, cv2.BORDER_REPLICATE)
        for a in (change.dent_mm, change.load)
    )
    weighted_mean = float((change.load**2).sum() / change.load.sum())
    deep = indentation > max(least_mm, _DENT_SHARE * float(indentation.max()))
    return np.asarray(indentation, np.float32), (load > _LOAD_SHARE * weighted_mean) & deep


def describe_if_no_contact(
    frame: TactileFrame, source: SensorSpec, calibration: Calibration | None, _sensitivity: float
) -> tuple[str, ...] | None:
    """Notes on a frame that differs from its reference by drift alone; None where something else may have changed."""
    image, reference = cast("Image", frame.image), cast("Image", frame.reference)
    pixel_mm = source.pixel_mm if calibration is None else calibration.pixel_mm
    seen = gel_surface.observe(image, reference, source, pixel_mm, frame.context_frames)
    if seen.change.verdict != "none":
        return None
    return (*seen.rest.notes, rest.describe_no_contact(seen.rest))


def _describe_illumination(illumination: Illumination | None, n_context_frames: int) -> list[str]:
    """Notes on fitted LEDs."""
    if illumination is None:
        return []
    if illumination.is_fitted_leds:
        to = f"{n_context_frames} touches of the recording" if illumination.from_context else "this touch"
        return [f"measured with this sensor's LEDs, fitted to {to}"]
    return [_SHADOW_LEDS] if illumination.model == "shadow_leds" else []


def _level_surface(surface: Floats, window: ImageWindow, source: SensorSpec, pixel_mm: float) -> tuple[Floats, Mask]:
    """The surface (rows, cols) with its rest at zero, and a mask of the inside of flat faces."""
    if source.gel is None:
        return surface, np.zeros_like(window.changed)
    by = max(1, round(max(source.camera.shape) / _PRESSURE_CELLS))
    cells = rest_level.downsample(surface, by)
    changed_share = rest_level.downsample(window.changed.astype(np.float32), by)
    pressure = contact.compute_relative_pressure(cells, _PRESSURE_BLUR_PX / by) / np.float32(pixel_mm * by)
    pressure[changed_share == 0] = 0.0
    certain = np.asarray(pressure > max(_CERTAIN_SLOPE, _CERTAIN_SHARE * float(pressure.max())), np.bool_)
    certain = contact.remove_weak_specks(certain, pressure, _SPECK_MM2 / (pixel_mm * by) ** 2, _GRAIN_SHARE)
    pressed = rest_level.upsample(certain.astype(np.float32), surface.shape)
    levelled = rest_level.level_surface(surface, pressed > 0.5, pixel_mm, source.gel)
    return levelled.surface_mm, levelled.face_interior


def _relax_surface(
    surface: Floats, touched: Mask, distance: Floats | None, window: ImageWindow, source: SensorSpec, pixel_mm: float
) -> Floats:
    """The surface (rows, cols) without what the gel cannot do.

    Outside a contact a nearly incompressible layer of thickness t, bonded to its back, falls to its rest within about
    t / 2 and bulges beyond: between t / 5 and 3 t / 5 from the contact, the measured surface passes into the mechanical
    one. Without a contact the surface stays as measured.
    """
    if source.gel is None or not touched.any():
        return surface * window.blend_weight
    thicknesses = _compute_distance(touched, pixel_mm, source.gel) if distance is None else distance
    keep = np.clip((_FADE_END - thicknesses) / (_FADE_END - _FADE_START), 0.0, 1.0)
    keep = np.maximum(keep * window.blend_weight, touched)
    beyond = rest_level.compute_far_field(surface, touched, pixel_mm, source.gel)
    return np.asarray(beyond + (surface - beyond) * keep, np.float32)


def _level_far_field(
    surface: Floats, touched: Mask, distance: Floats | None, window: ImageWindow, source: SensorSpec, pixel_mm: float
) -> Floats:
    """The surface (rows, cols), shifted to the height that mechanics give it far from the contact.

    Only for light whose LEDs are known: other light is estimated from surfaces that are at rest outside the contact.
    """
    if source.gel is None or distance is None or not touched.any():
        return surface
    far = (distance > _FAR) & window.changed
    return rest_level.level_by_far_field(surface, touched, far, pixel_mm, source.gel)


def _compute_distance(touched: Mask, pixel_mm: float, gel: Gel) -> Floats:
    """Distance of each pixel (rows, cols) from the contact, in gel thicknesses."""
    import cv2

    distance_px = cv2.distanceTransform((~touched).astype(np.uint8), cv2.DIST_L2, 5)
    return np.asarray(distance_px, np.float32) * np.float32(pixel_mm / gel.thickness_mm)


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
