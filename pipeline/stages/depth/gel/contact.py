"""Node *contact*: where a gel's surface touches, and how it lies around that."""

from dataclasses import dataclass
from typing import cast

import numpy as np

from pipeline.calibration import near_led_prior
from pipeline.core.arrays import Floats, Image, Mask
from pipeline.core.errors import StageWarning
from pipeline.core.progress import Progress
from pipeline.core.values.frames import TactileFrame
from pipeline.core.values.results import DepthMap
from pipeline.sensors.spec import Gel, SensorSpec
from pipeline.stages.depth import contact, false_contacts, mirror_check, rest_level
from pipeline.stages.depth.change_detection import ImageWindow
from pipeline.stages.depth.gel.change import FrameChange
from pipeline.stages.depth.gel.rest import RestState
from pipeline.stages.depth.gel.result import make_gel_depth
from pipeline.stages.depth.gel.slopes import FrameSlopes
from pipeline.stages.depth.gel.surface import FrameSurface
from pipeline.stages.depth.illumination.light import FrameLight

# gel thicknesses from the contact, see `_relax_surface`
_FADE_START = 0.2
_FADE_END = 0.6
# gel thicknesses from the contact: the gel is neither indented nor pulled down there (`rest_level`)
_FAR = 0.7
_PRESSURE_BLUR_PX = 1.5  # blur of the relative pressure that separates certain contact (chosen)
_CONTACT_BLUR_PX = 1.0
_PRESSURE_CELLS = 220  # of that pressure's grid, along the longer side
# mm/mm, and of the peak: relative pressure that noise does not reach
_CERTAIN_SLOPE = 0.04
_CERTAIN_SHARE = 0.1
_GRAIN_SHARE = 0.5  # of the peak: a speck with this much pressure is no noise
_SPECK_MM2 = 0.15  # smaller contacts are camera noise
# gaps that a rough ball or a book leaves between its threads (`benchmarks/real_things.py`)
_HOLE_MM2 = 0.5
_WEAK_SHADING = StageWarning(
    "the LEDs hardly shade slopes where the sensor is touched: sizes and depths may be wrong by "
    "half; calibrate"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class ContactParams:
    """Parameters of the node."""

    contact_limit: float  # times the sensor's smallest indentation
    pressure_share: float  # of the peak nearby


def detect_contact(
    frame: TactileFrame,
    rest: RestState,
    change: FrameChange,
    light: FrameLight,
    slopes: FrameSlopes,
    surface: FrameSurface,
    params: ContactParams,
    progress: Progress,
) -> DepthMap:
    """The depth map of a surface: its contact, and what mechanics let the gel do around it."""
    progress.step(0.0, "relaxing the gel around the contact")
    source = rest.source
    changed = slopes.changed
    used = light.illumination
    calibration = light.calibration
    window = changed.window
    pixel_mm = calibration.pixel_mm
    shape = source.camera.shape
    here = (window.rows, window.cols)
    notes = [*change.rest.notes, *slopes.notes, *light.notes, *surface.notes]
    z, inside = _level_surface(surface.surface_mm, window, source, pixel_mm)
    pressed = inside | contact.detect_contact(
        z,
        pixel_mm,
        least_mm=params.contact_limit * source.limits.contact_min_mm,
        pressure_share=params.pressure_share,
        smoothing_px=_CONTACT_BLUR_PX,
    )
    pressed = contact.remove_specks(
        pressed & (window.changed | inside), max(4, round(_SPECK_MM2 / pixel_mm**2))
    )
    border = np.pad(np.zeros((shape[0] - 2, shape[1] - 2), np.bool_), 1, constant_values=True)[here]
    patch, _ = changed.patches
    change_grey = patch.change * patch.unmarked_share
    pressed = false_contacts.remove_false_contacts(
        pressed, z, pixel_mm, border, window.changed, change_grey
    )
    pressed = contact.fill_small_holes(pressed, round(_HOLE_MM2 / pixel_mm**2))
    touched = np.zeros(shape, np.bool_)
    touched[here] = pressed
    indentation = np.zeros(shape, np.float32)
    indentation[here] = z * window.blend_weight
    if source.gel is not None and pressed.any():
        is_lit = used is not None and used.is_trusted
        indentation[here] = _relax_surface(z, pressed, window, source.gel, pixel_mm, levels=is_lit)
    by_near_leds = used is not None and used.model in {"field", "near"}
    if by_near_leds and near_led_prior.has_weak_shading(touched, change.rest.image, source):
        notes.append(_WEAK_SHADING)
    return make_gel_depth(
        indentation,
        touched,
        frame,
        rest,
        tuple(notes),
        calibration=calibration,
        illumination=used,
        mirroring=mirror_check.describe_mirroring(cast("Image", frame.reference), source, changed),
    )


def _level_surface(
    surface: Floats, window: ImageWindow, source: SensorSpec, pixel_mm: float
) -> tuple[Floats, Mask]:
    """The surface (rows, cols) with its rest at zero, and a mask of the inside of flat faces."""
    if source.gel is None:
        return surface, np.zeros_like(window.changed)
    by = max(1, round(max(source.camera.shape) / _PRESSURE_CELLS))
    cells = rest_level.downsample(surface, by)
    changed_share = rest_level.downsample(window.changed.astype(np.float32), by)
    pressure = contact.compute_relative_pressure(cells, _PRESSURE_BLUR_PX / by) / np.float32(
        pixel_mm * by
    )
    pressure[changed_share == 0] = 0.0
    certain = np.asarray(
        pressure > max(_CERTAIN_SLOPE, _CERTAIN_SHARE * float(pressure.max())), np.bool_
    )
    certain = contact.remove_weak_specks(
        certain, pressure, _SPECK_MM2 / (pixel_mm * by) ** 2, _GRAIN_SHARE
    )
    pressed = rest_level.upsample(certain.astype(np.float32), surface.shape)
    levelled = rest_level.level_surface(surface, pressed > 0.5, pixel_mm, source.gel)
    return levelled.surface_mm, levelled.face_interior


def _relax_surface(
    surface: Floats,
    touched: Mask,
    window: ImageWindow,
    gel: Gel,
    pixel_mm: float,
    *,
    levels: bool,
) -> Floats:
    """The surface (rows, cols) without what the gel cannot do.

    Outside a contact a nearly incompressible layer of thickness t, bonded to its back, falls to its
    rest within about t / 2 and bulges beyond: between t / 5 and 3 t / 5 from the contact, the
    measured surface passes into the mechanical one. `levels`: the surface is shifted to the height
    that mechanics give it far from the contact; only for light whose LEDs are known, as other light
    is estimated from surfaces that are at rest outside the contact.
    """
    import cv2

    away_px = np.asarray(cv2.distanceTransform((~touched).astype(np.uint8), cv2.DIST_L2, 5))
    thicknesses = away_px * np.float32(pixel_mm / gel.thickness_mm)
    if levels:
        far = (thicknesses > _FAR) & window.changed
        surface = rest_level.level_by_far_field(surface, touched, far, pixel_mm, gel)
    keep = np.clip((_FADE_END - thicknesses) / (_FADE_END - _FADE_START), 0.0, 1.0)
    keep = np.maximum(keep * window.blend_weight, touched)
    beyond = rest_level.compute_far_field(surface, touched, pixel_mm, gel)
    return np.asarray(beyond + (surface - beyond) * keep, np.float32)
