"""Depth of a gel: colour change -> slopes -> surface -> contact, worked out only around what has moved.

Drift of the light and of the camera is taken out first (`drift`). Where the look-up is the one that the sensor's
description implies, the surface is then corrected by its own optics (`gel_light`), in the light that
the touch itself speaks for (`own_light`), or several of its recording (`unit_light`).

Numbers without a source beside them are those that `benchmarks/depth_numbers.py` finds no better neighbour of, a third
less or half as much again: the best of these take 3 % off the error, the worst add 9 %.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from pipeline.base.arrays import Floats, Image, Mask, freeze
from pipeline.base.errors import ShapeError
from pipeline.base.progress import Progress
from pipeline.base.stage_warnings import AT_BORDER, StageWarning
from pipeline.calibration.calibration_table import Calibration, check_calibration, make_built_in
from pipeline.sensors.parts import Optics
from pipeline.sensors.spec import Gel, SensorSpec
from pipeline.stages.depth import (
    adaptive_illumination,
    change_detection,
    contact,
    drift,
    false_contacts,
    gel_surface,
    instance_check,
    recording_led_calibration,
    rest_level,
    surface_refinement,
)
from pipeline.stages.depth.change_detection import ImageWindow
from pipeline.stages.depth.gel_surface import ChangedImage
from pipeline.stages.depth.poisson import Boundary
from pipeline.stages.depth.shadow_model import LedArray
from pipeline.values.frames import TactileFrame
from pipeline.values.pixel_index import make_pixel_index
from pipeline.values.results import DepthMap

_FADES_FROM, _GONE_AT = 0.2, 0.6  # thicknesses from the contact, see `_relaxed`
_FAR = 0.7  # thicknesses from the contact: as `rest` has it, the gel is neither pressed nor pulled down there
_SATURATED_GREY = 254  # noise of a grey level takes what is clipped at 255 down to here
_TELL_SATURATED = 0.01  # of the touch
_PRESSURE_BLUR_PX = 1.5  # of what certainly presses
_CONTACT_BLUR_PX = 1.0
_PRESSURE_CELLS = 220  # of the grid on which it is told what certainly presses, along the longer side
_CERTAIN, _CERTAIN_SHARE = 0.04, 0.1  # mm/mm, and of the peak: pressure, in slopes, that noise does not make
_GRAIN_SHARE = 0.5  # of the peak: a speck that presses so hard is no noise
_SPECK_MM2 = 0.15  # smaller contacts are camera noise
_HOLE_MM2 = 0.5  # what a rough ball or a book leaves between its threads: those of `benchmarks/real_things.py`
_FULL_SHARE = 0.9  # of the view
_HARDLY_TOLD = StageWarning(
    "the touch lies where the lamps hardly tell slopes: sizes and depths there may be wrong by half"
)
_NO_PRESS_NEAR = StageWarning("no press of the calibration tells the light of this touch: it is read without")
_LOST_ONCE = "no usual unit's lamps explain the picture: read by low ones, fitted to this touch, that dents hide"
_NARROW = 0.5  # thicknesses, within which the gel beyond the border bears on what is seen


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredSurface:
    """A gel's surface as its slopes have it, before what is beside the contact gives way to mechanics."""

    surface_mm: Floats  # of the window
    window: ImageWindow
    source: SensorSpec
    pixel_mm: float
    light: adaptive_illumination.Illumination | None  # that it was read by; None where the look-up has its own

    def expand_to_frame(self) -> Floats:
        """The surface as measured (rows, cols); zero beside the window."""
        whole = np.zeros(self.source.camera.shape, np.float32)
        whole[self.window.rows, self.window.cols] = self.surface_mm
        return whole

    def relax_outside_contact(self, touched: Mask, away: Floats | None = None) -> Floats:
        """The indentation (rows, cols) in mm when this is the contact (rows, cols); zero beside the window.

        `away`, how far the window's pixels lie from the contact, in thicknesses of the gel, need not be known.
        """
        here = (self.window.rows, self.window.cols)
        indentation = np.zeros(touched.shape, np.float32)
        indentation[here] = _relaxed(self.surface_mm, touched[here], away, self.window, self.source, self.pixel_mm)
        return indentation


def measure_gel_depth(
    frame: TactileFrame,
    source: SensorSpec,
    calibration: Calibration,
    *,
    no_touch_grey: float,
    least_mm: float,
    pressure_share: float,
    smoothing_px: float,
    boundary: Boundary,
    progress: Progress,
    iterations: int = surface_refinement.MAX_ITERATIONS,
    light: adaptive_illumination.Illumination | None = None,
) -> tuple[DepthMap, MeasuredSurface | None]:
    """The depth of one gel picture, see `pipeline.stages.depth.photometric.depth`; the frame has been checked there.

    Beside it what it was made of, for who knows the contact better; None where nothing has changed. `rounds` are those
    of the correction by the sensor's own optics: fewer make a draft. A `light` that is known is not looked for.
    """
    image, reference = cast("Image", frame.image), cast("Image | None", frame.reference)
    if reference is None:
        raise ShapeError("a gel's depth needs a reference image")
    check_calibration(calibration, source.name, image)
    shape, pixel_mm = source.camera.shape, calibration.pixel_mm
    indentation, touched = np.zeros(shape, np.float32), np.zeros(shape, np.bool_)
    still = drift.apply_estimated_drift(image, reference)
    notes, measured = [*instance_check.check_sensor_instance(calibration, reference), *still.notes], None
    window = change_detection.detect_change(image, still.image_8bit, no_touch_grey, pixel_mm)
    if window is None:
        notes.append(drift.describe_no_contact(still))
    else:
        here = (window.rows, window.cols)
        notes += _doubts(image[here], source, window)
        if not calibration.covers(window.changed, (window.rows.start, window.cols.start)):
            notes.append(_NO_PRESS_NEAR)
            calibration = replace(
                make_built_in(source), pixel_mm=pixel_mm, median_pressure_share=calibration.median_pressure_share
            )
        progress.step(0.2, "integrating slopes")
        changed = ChangedImage(
            image=image, reference=still, window=window, source=source, calibration=calibration,
            smoothing_px=smoothing_px, boundary=boundary,
        )  # fmt: skip
        pooled = (
            recording_led_calibration.fit_recording_leds(frame.context_frames, reference, changed, progress)
            if light is None
            else None
        )
        light = light if pooled is None else pooled
        surface, light = gel_surface.estimate_surface(changed, iterations, light, progress)
        if isinstance(light, Optics) and light != source.optics:
            of = "this touch" if pooled is None else f"{len(frame.context_frames)} touches of the recording"
            notes.append(f"read by the lamps of this unit, fitted to {of}")
        if isinstance(light, LedArray):
            notes.append(_LOST_ONCE)
        surface, inside = _level_surface(surface, window, source, pixel_mm)
        pressed = inside | contact.detect_contact(
            surface, pixel_mm, least_mm=least_mm, pressure_share=pressure_share, smoothing_px=_CONTACT_BLUR_PX,
            median_pressure_share=calibration.median_pressure_share or contact.MEDIAN_PRESSURE_SHARE,
        )  # fmt: skip
        pressed = contact.remove_specks(pressed & (window.changed | inside), max(4, round(_SPECK_MM2 / pixel_mm**2)))
        pressed = false_contacts.remove_false_contacts(pressed, surface, pixel_mm, _border(shape)[here], window.changed)
        pressed = contact.fill_small_holes(pressed, round(_HOLE_MM2 / pixel_mm**2))
        narrow_px = _NARROW * (0.0 if source.gel is None else source.gel.thickness_mm) / pixel_mm
        touched[here] = contact.remove_border_artifacts(pressed, surface, *here, shape, narrow_px)
        away = None if source.gel is None else _away(touched[here], pixel_mm, source.gel)
        if adaptive_illumination.is_trusted(light) or isinstance(light, LedArray):
            surface = _lowered(surface, touched[here], away, window, source, pixel_mm)
        progress.step(0.8, "relaxing the gel around the contact")
        measured = MeasuredSurface(
            surface_mm=freeze(surface), window=window, source=source, pixel_mm=pixel_mm, light=light
        )  # fmt: skip
        indentation = measured.relax_outside_contact(touched, away)
        by_near = isinstance(light, np.ndarray) or (isinstance(light, str) and light == "near")
        if by_near and surface_refinement.has_weak_shading(touched, still.image, source):
            notes.append(_HARDLY_TOLD)
        notes += _limits(indentation, touched, source.limits.indentation_max_mm)
    progress.step(1.0, "depth is ready")
    found = DepthMap(
        indentation_mm=freeze(indentation),
        depth_mm=freeze((source.rest_depth_mm - indentation).astype(np.float32)),
        contact=freeze(touched),
        camera=source.camera,
        source_index=make_pixel_index(shape),
        notes=tuple(notes),
    )
    return found, measured


def describe_if_no_contact(image: Image, reference: Image, no_touch_grey: float) -> tuple[str, ...] | None:
    """What is said of a picture in which nothing has changed but by drift; None where something has."""
    change = change_detection.compute_largest_change(image, reference)
    if change < no_touch_grey:
        return ("nothing touches the sensor",)
    if not math.isfinite(change):
        return None
    still = drift.apply_estimated_drift(image, reference)
    if still.drift is None or not change_detection.compute_largest_change(image, still.image_8bit) < no_touch_grey:
        return None
    return (*still.notes, drift.describe_no_contact(still))


def _level_surface(surface: Floats, window: ImageWindow, source: SensorSpec, pixel_mm: float) -> tuple[Floats, Mask]:
    """The surface with its rest at zero, and the inside of faces."""
    if source.gel is None:
        return surface, np.zeros_like(window.changed)
    by = max(1, round(max(source.camera.shape) / _PRESSURE_CELLS))
    small, moved_share = (
        rest_level.downsample(surface, by),
        rest_level.downsample(window.changed.astype(np.float32), by),
    )
    pressure = contact.compute_relative_pressure(small, _PRESSURE_BLUR_PX / by) / np.float32(pixel_mm * by)
    pressure[moved_share == 0] = 0.0
    certain = np.asarray(pressure > max(_CERTAIN, _CERTAIN_SHARE * float(pressure.max())), np.bool_)
    certain = contact.remove_weak_specks(certain, pressure, _SPECK_MM2 / (pixel_mm * by) ** 2, _GRAIN_SHARE)
    pressed = rest_level.upsample(certain.astype(np.float32), surface.shape)
    found = rest_level.level_surface(surface, pressed > 0.5, pixel_mm, source.gel)
    return found.surface_mm, found.face_interior


def _relaxed(
    surface: Floats, touched: Mask, away: Floats | None, window: ImageWindow, source: SensorSpec, pixel_mm: float
) -> Floats:
    """The surface without what cannot be the gel's doing.

    Beside a contact a nearly incompressible layer of thickness t, bonded to its back, falls to its rest within about
    t / 2 and bulges out beyond: between t / 5 and 3 t / 5 from the contact what was measured passes into what
    mechanics make of the contact. Without a contact the surface stays as it was measured.
    """
    if source.gel is None or not touched.any():
        return surface * window.blend_weight
    thicknesses = _away(touched, pixel_mm, source.gel) if away is None else away
    keep = np.clip((_GONE_AT - thicknesses) / (_GONE_AT - _FADES_FROM), 0.0, 1.0)
    keep = np.maximum(keep * window.blend_weight, touched)
    beyond = rest_level.compute_far_field(surface, touched, pixel_mm, source.gel)
    return np.asarray(beyond + (surface - beyond) * keep, np.float32)


def _lowered(
    surface: Floats, touched: Mask, away: Floats | None, window: ImageWindow, source: SensorSpec, pixel_mm: float
) -> Floats:
    """The surface as high far from the contact as mechanics have it there, for a light that is known.

    Another light is found together with the depth, of surfaces that are at rest beside the contact.
    """
    if source.gel is None or away is None or not touched.any():
        return surface
    far = (away > _FAR) & window.changed
    return rest_level.level_by_far_field(surface, touched, far, pixel_mm, source.gel)


def _away(touched: Mask, pixel_mm: float, gel: Gel) -> Floats:
    """How far every pixel (rows, cols) lies from the contact, in thicknesses of the gel."""
    import cv2

    away = cv2.distanceTransform((~touched).astype(np.uint8), cv2.DIST_L2, 5)
    return np.asarray(away, np.float32) * np.float32(pixel_mm / gel.thickness_mm)


def _border(shape: tuple[int, int]) -> Mask:
    border = np.ones(shape, np.bool_)
    border[1:-1, 1:-1] = False
    return border


def _doubts(part: Image, source: SensorSpec, window: ImageWindow) -> list[str]:
    """What is said about slopes that the picture does not show."""
    notes: list[str] = []
    if source.markers is not None:
        notes.append("slopes under the printed markers were filled in from around them")
    import cv2

    red, green, blue = cv2.split(part)
    clipped = np.asarray(cv2.max(cv2.max(red, green), blue)) >= _SATURATED_GREY
    share = np.count_nonzero(clipped & window.changed) / np.count_nonzero(window.changed)
    if share > _TELL_SATURATED:
        notes.append(StageWarning(f"{share:.0%} of the touch is saturated: slopes there are doubtful"))
    return notes


def _limits(indentation: Floats, touched: Mask, largest_mm: float) -> list[str]:
    """Bring the indentation within the sensor's reach, and say what was brought."""
    notes: list[str] = []
    beyond = indentation > largest_mm
    if beyond.any():
        told = f"{int(beyond.sum())} pixels were deeper than the sensor's {largest_mm:g} mm and were cut to that"
        notes.append(StageWarning(told))
        np.minimum(indentation, np.float32(largest_mm), out=indentation)
    edge = np.concatenate([touched[0], touched[-1], touched[:, 0], touched[:, -1]])
    if touched.sum() > _FULL_SHARE * touched.size:
        notes.append(
            StageWarning("the contact fills the view: how deep it is was guessed from what little lies beside it")
        )
    elif edge.any():
        notes.append(AT_BORDER)
    if not touched.any():
        notes.append("the picture has changed, but nothing presses hard enough to be a contact")
    return notes
