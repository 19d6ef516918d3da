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
from pipeline.base.doubts import AT_BORDER, Doubt
from pipeline.base.errors import ShapeError
from pipeline.base.progress import Progress
from pipeline.calibration.lookup import Calibration, built_in, check_for
from pipeline.sensors.parts import Optics
from pipeline.sensors.spec import Gel, SensorSpec
from pipeline.stages.depth import (
    contact,
    drift,
    flanks,
    gel_light,
    lit_surface,
    moved,
    own_light,
    own_unit,
    rest,
    unit_light,
)
from pipeline.stages.depth.cast_light import Lamps
from pipeline.stages.depth.lit_surface import Changed
from pipeline.stages.depth.moved import Window
from pipeline.stages.depth.poisson import Boundary
from pipeline.values.frames import TactileFrame
from pipeline.values.pixel_index import pixel_index
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
_HARDLY_TOLD = Doubt("the touch lies where the lamps hardly tell slopes: sizes and depths there may be wrong by half")
_NO_PRESS_NEAR = Doubt("no press of the calibration tells the light of this touch: it is read without")
_LOST_ONCE = "no usual unit's lamps explain the picture: read by low ones, fitted to this touch, that dents hide"
_NARROW = 0.5  # thicknesses, within which the gel beyond the border bears on what is seen


@dataclass(frozen=True, slots=True, kw_only=True)
class Measured:
    """A gel's surface as its slopes have it, before what is beside the contact gives way to mechanics."""

    surface_mm: Floats  # of the window
    window: Window
    source: SensorSpec
    pixel_mm: float
    light: own_light.Told | None  # that it was read by; None where the look-up has its own

    def raw(self) -> Floats:
        """The surface as measured (rows, cols); zero beside the window."""
        whole = np.zeros(self.source.camera.shape, np.float32)
        whole[self.window.rows, self.window.cols] = self.surface_mm
        return whole

    def relaxed(self, touched: Mask, away: Floats | None = None) -> Floats:
        """The indentation (rows, cols) in mm when this is the contact (rows, cols); zero beside the window.

        `away`, how far the window's pixels lie from the contact, in thicknesses of the gel, need not be known.
        """
        here = (self.window.rows, self.window.cols)
        indentation = np.zeros(touched.shape, np.float32)
        indentation[here] = _relaxed(self.surface_mm, touched[here], away, self.window, self.source, self.pixel_mm)
        return indentation


def read(
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
    rounds: int = gel_light.ROUNDS,
    light: own_light.Told | None = None,
) -> tuple[DepthMap, Measured | None]:
    """The depth of one gel picture, see `pipeline.stages.depth.stage.depth`; the frame has been checked there.

    Beside it what it was made of, for who knows the contact better; None where nothing has changed. `rounds` are those
    of the correction by the sensor's own optics: fewer make a draft. A `light` that is known is not looked for.
    """
    image, reference = cast("Image", frame.image), cast("Image | None", frame.reference)
    if reference is None:
        raise ShapeError("a gel's depth needs a reference image")
    check_for(calibration, source.name, image)
    shape, pixel_mm = source.camera.shape, calibration.pixel_mm
    indentation, touched = np.zeros(shape, np.float32), np.zeros(shape, np.bool_)
    still = drift.stilled(image, reference)
    notes, measured = [*own_unit.notes(calibration, reference), *still.notes], None
    window = moved.window(image, still.grey, no_touch_grey, pixel_mm)
    if window is None:
        notes.append(drift.untouched_note(still))
    else:
        here = (window.rows, window.cols)
        notes += _doubts(image[here], source, window)
        if not calibration.tells(window.moved, (window.rows.start, window.cols.start)):
            notes.append(_NO_PRESS_NEAR)
            calibration = replace(built_in(source), pixel_mm=pixel_mm, usual_share=calibration.usual_share)
        progress.step(0.2, "integrating slopes")
        changed = Changed(
            image=image, still=still, window=window, source=source, calibration=calibration,
            smoothing_px=smoothing_px, boundary=boundary,
        )  # fmt: skip
        pooled = unit_light.fitted(frame.beside, reference, changed, progress) if light is None else None
        light = light if pooled is None else pooled
        surface, light = lit_surface.surface(changed, rounds, light, progress)
        if isinstance(light, Optics) and light != source.optics:
            of = "this touch" if pooled is None else f"{len(frame.beside)} touches of the recording"
            notes.append(f"read by the lamps of this unit, fitted to {of}")
        if isinstance(light, Lamps):
            notes.append(_LOST_ONCE)
        surface, inside = _settled(surface, window, source, pixel_mm)
        pressed = inside | contact.touched(
            surface, pixel_mm, least_mm=least_mm, pressure_share=pressure_share, smoothing_px=_CONTACT_BLUR_PX,
            usual_share=calibration.usual_share or contact.USUAL_SHARE,
        )  # fmt: skip
        pressed = contact.without_specks(pressed & (window.moved | inside), max(4, round(_SPECK_MM2 / pixel_mm**2)))
        pressed = flanks.pressed_in(pressed, surface, pixel_mm, _border(shape)[here], window.moved)
        pressed = contact.without_small_holes(pressed, round(_HOLE_MM2 / pixel_mm**2))
        narrow_px = _NARROW * (0.0 if source.gel is None else source.gel.thickness_mm) / pixel_mm
        touched[here] = contact.without_margins(pressed, surface, *here, shape, narrow_px)
        away = None if source.gel is None else _away(touched[here], pixel_mm, source.gel)
        if own_light.explains(light) or isinstance(light, Lamps):
            surface = _lowered(surface, touched[here], away, window, source, pixel_mm)
        progress.step(0.8, "relaxing the gel around the contact")
        measured = Measured(
            surface_mm=freeze(surface), window=window, source=source, pixel_mm=pixel_mm, light=light
        )  # fmt: skip
        indentation = measured.relaxed(touched, away)
        by_near = isinstance(light, np.ndarray) or (isinstance(light, str) and light == "near")
        if by_near and gel_light.hardly_told(touched, still.picture, source):
            notes.append(_HARDLY_TOLD)
        notes += _limits(indentation, touched, source.limits.indentation_max_mm)
    progress.step(1.0, "depth is ready")
    found = DepthMap(
        indentation_mm=freeze(indentation),
        depth_mm=freeze((source.rest_depth_mm - indentation).astype(np.float32)),
        contact=freeze(touched),
        camera=source.camera,
        source_index=pixel_index(shape),
        notes=tuple(notes),
    )
    return found, measured


def untouched_notes(image: Image, reference: Image, no_touch_grey: float) -> tuple[str, ...] | None:
    """What is said of a picture in which nothing has changed but by drift; None where something has."""
    change = moved.largest_change(image, reference)
    if change < no_touch_grey:
        return ("nothing touches the sensor",)
    if not math.isfinite(change):
        return None
    still = drift.stilled(image, reference)
    if still.drift is None or not moved.largest_change(image, still.grey) < no_touch_grey:
        return None
    return (*still.notes, drift.untouched_note(still))


def _settled(surface: Floats, window: Window, source: SensorSpec, pixel_mm: float) -> tuple[Floats, Mask]:
    """The surface with its rest at zero, and the inside of faces."""
    if source.gel is None:
        return surface, np.zeros_like(window.moved)
    by = max(1, round(max(source.camera.shape) / _PRESSURE_CELLS))
    small, moved_share = rest.coarse(surface, by), rest.coarse(window.moved.astype(np.float32), by)
    pressure = contact.relative_pressure(small, _PRESSURE_BLUR_PX / by) / np.float32(pixel_mm * by)
    pressure[moved_share == 0] = 0.0
    certain = np.asarray(pressure > max(_CERTAIN, _CERTAIN_SHARE * float(pressure.max())), np.bool_)
    certain = contact.without_grains(certain, pressure, _SPECK_MM2 / (pixel_mm * by) ** 2, _GRAIN_SHARE)
    pressed = rest.fine(certain.astype(np.float32), surface.shape)
    found = rest.settled(surface, pressed > 0.5, pixel_mm, source.gel)
    return found.surface_mm, found.inside


def _relaxed(
    surface: Floats, touched: Mask, away: Floats | None, window: Window, source: SensorSpec, pixel_mm: float
) -> Floats:
    """The surface without what cannot be the gel's doing.

    Beside a contact a nearly incompressible layer of thickness t, bonded to its back, falls to its rest within about
    t / 2 and bulges out beyond: between t / 5 and 3 t / 5 from the contact what was measured passes into what
    mechanics make of the contact. Without a contact the surface stays as it was measured.
    """
    if source.gel is None or not touched.any():
        return surface * window.share
    thicknesses = _away(touched, pixel_mm, source.gel) if away is None else away
    keep = np.clip((_GONE_AT - thicknesses) / (_GONE_AT - _FADES_FROM), 0.0, 1.0)
    keep = np.maximum(keep * window.share, touched)
    beyond = rest.far_field(surface, touched, pixel_mm, source.gel)
    return np.asarray(beyond + (surface - beyond) * keep, np.float32)


def _lowered(
    surface: Floats, touched: Mask, away: Floats | None, window: Window, source: SensorSpec, pixel_mm: float
) -> Floats:
    """The surface as high far from the contact as mechanics have it there, for a light that is known.

    Another light is found together with the depth, of surfaces that are at rest beside the contact.
    """
    if source.gel is None or away is None or not touched.any():
        return surface
    far = (away > _FAR) & window.moved
    return rest.lowered(surface, touched, far, pixel_mm, source.gel)


def _away(touched: Mask, pixel_mm: float, gel: Gel) -> Floats:
    """How far every pixel (rows, cols) lies from the contact, in thicknesses of the gel."""
    import cv2

    away = cv2.distanceTransform((~touched).astype(np.uint8), cv2.DIST_L2, 5)
    return np.asarray(away, np.float32) * np.float32(pixel_mm / gel.thickness_mm)


def _border(shape: tuple[int, int]) -> Mask:
    border = np.ones(shape, np.bool_)
    border[1:-1, 1:-1] = False
    return border


def _doubts(part: Image, source: SensorSpec, window: Window) -> list[str]:
    """What is said about slopes that the picture does not show."""
    notes: list[str] = []
    if source.markers is not None:
        notes.append("slopes under the printed markers were filled in from around them")
    import cv2

    red, green, blue = cv2.split(part)
    clipped = np.asarray(cv2.max(cv2.max(red, green), blue)) >= _SATURATED_GREY
    share = np.count_nonzero(clipped & window.moved) / np.count_nonzero(window.moved)
    if share > _TELL_SATURATED:
        notes.append(Doubt(f"{share:.0%} of the touch is saturated: slopes there are doubtful"))
    return notes


def _limits(indentation: Floats, touched: Mask, largest_mm: float) -> list[str]:
    """Bring the indentation within the sensor's reach, and say what was brought."""
    notes: list[str] = []
    beyond = indentation > largest_mm
    if beyond.any():
        told = f"{int(beyond.sum())} pixels were deeper than the sensor's {largest_mm:g} mm and were cut to that"
        notes.append(Doubt(told))
        np.minimum(indentation, np.float32(largest_mm), out=indentation)
    edge = np.concatenate([touched[0], touched[-1], touched[:, 0], touched[:, -1]])
    if touched.sum() > _FULL_SHARE * touched.size:
        notes.append(Doubt("the contact fills the view: how deep it is was guessed from what little lies beside it"))
    elif edge.any():
        notes.append(AT_BORDER)
    if not touched.any():
        notes.append("the picture has changed, but nothing presses hard enough to be a contact")
    return notes
