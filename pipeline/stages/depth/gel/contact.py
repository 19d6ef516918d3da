"""Node *contact*: where a gel's surface touches, and how it lies around that."""

from typing import cast

import numpy as np

from pipeline.core.arrays import Floats, Image, Mask, median, percentile
from pipeline.core.frozen import frozen
from pipeline.core.progress import Progress
from pipeline.core.values.frames import TactileFrame
from pipeline.core.values.results import DepthMap
from pipeline.physics.optics import compute_slopes
from pipeline.sensors.spec import Gel, SensorSpec
from pipeline.stages.depth import contact, rest_level
from pipeline.stages.depth.change_detection import ImageWindow
from pipeline.stages.depth.gel.change import FrameChange
from pipeline.stages.depth.gel.rest import RestState
from pipeline.stages.depth.gel.result import make_gel_depth
from pipeline.stages.depth.gel.settings import CONTACT, ContactSettings
from pipeline.stages.depth.gel.slopes import FrameSlopes, describe_mirroring
from pipeline.stages.depth.gel.surface import FrameSurface
from pipeline.stages.depth.illumination.light import FrameLight


@frozen
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
    z, inside = _level_surface(surface.surface_mm, window, source, pixel_mm, CONTACT)
    pressed = inside | contact.detect_contact(
        z,
        pixel_mm,
        least_mm=params.contact_limit * source.limits.contact_min_mm,
        pressure_share=params.pressure_share,
        settings=CONTACT,
    )
    pressed = contact.remove_specks(
        pressed & (window.changed | inside), max(4, round(CONTACT.speck_mm2 / pixel_mm**2))
    )
    border = np.pad(np.zeros((shape[0] - 2, shape[1] - 2), np.bool_), 1, constant_values=True)[here]
    patch, _ = changed.patches
    seen = (patch.change, patch.unmarked_share)
    pressed = remove_false_contacts(pressed, z, pixel_mm, border, window.changed, seen, CONTACT)
    pressed = contact.fill_small_holes(pressed, round(CONTACT.hole_mm2 / pixel_mm**2))
    touched = np.zeros(shape, np.bool_)
    touched[here] = pressed
    indentation = np.zeros(shape, np.float32)
    if source.gel is not None and pressed.any():
        indentation[here] = z
        is_lit = used is not None and used.is_trusted
        indentation = _relax_surface(
            indentation, touched, window, source.gel, pixel_mm, CONTACT, levels=is_lit
        )
    else:
        indentation[here] = z * window.blend_weight
    return make_gel_depth(
        indentation,
        touched,
        frame,
        rest,
        tuple(notes),
        calibration=calibration,
        illumination=used,
        mirroring=describe_mirroring(cast("Image", frame.reference), source, changed),
    )


def _level_surface(
    surface: Floats,
    window: ImageWindow,
    source: SensorSpec,
    pixel_mm: float,
    settings: ContactSettings,
) -> tuple[Floats, Mask]:
    """The surface (rows, cols) with its rest at zero, and a mask of the inside of flat faces."""
    if source.gel is None:
        return surface, np.zeros_like(window.changed)
    by = max(1, round(max(source.camera.shape) / settings.certain_cells))
    cells = contact.downsample(surface, by)
    changed_share = contact.downsample(window.changed.astype(np.float32), by)
    pressure = contact.compute_relative_pressure(cells, settings.certain_blur_px / by)
    pressure /= np.float32(pixel_mm * by)
    pressure[changed_share == 0] = 0.0
    least = max(settings.certain_slope, settings.certain_share * float(pressure.max()))
    certain = np.asarray(pressure > least, np.bool_)
    certain = contact.remove_weak_specks(
        certain, pressure, settings.speck_mm2 / (pixel_mm * by) ** 2, settings.grain_share
    )
    pressed = contact.upsample(certain.astype(np.float32), surface.shape)
    levelled = rest_level.level_surface(surface, pressed > 0.5, pixel_mm, source.gel, settings)
    return levelled.surface_mm, levelled.face_interior


def _relax_surface(
    surface: Floats,
    touched: Mask,
    window: ImageWindow,
    gel: Gel,
    pixel_mm: float,
    settings: ContactSettings,
    *,
    levels: bool,
) -> Floats:
    """The surface (rows, cols) of the image without what the gel cannot do.

    Outside a contact a nearly incompressible layer of thickness t, bonded to its back, falls to its
    rest within about t / 2 and bulges beyond: between t / 5 and 3 t / 5 from the contact, the
    measured surface passes into the mechanical one, which goes on beyond the window. `levels`: the
    surface is shifted to the height that mechanics give it far from the contact; only for light
    whose LEDs are known, as other light is estimated from surfaces that are at rest outside the
    contact.
    """
    import cv2

    here = (window.rows, window.cols)
    pressed = touched[here]
    away_px = np.asarray(cv2.distanceTransform((~pressed).astype(np.uint8), cv2.DIST_L2, 5))
    thicknesses = away_px * np.float32(pixel_mm / gel.thickness_mm)
    far = None
    if levels:
        far = np.zeros_like(touched)
        far[here] = (thicknesses > settings.quiet_distance) & window.changed
    beyond, shift = rest_level.compute_far_field(surface, touched, pixel_mm, gel, settings, far)
    low, high = settings.fade_distances
    keep = np.clip((high - thicknesses) / (high - low), 0.0, 1.0)
    keep = np.maximum(keep * window.blend_weight, pressed)
    relaxed = np.array(beyond, np.float32)
    relaxed[here] += (surface[here] + shift - beyond[here]) * keep
    return relaxed


def remove_false_contacts(
    touched: Mask,
    surface_mm: Floats,
    pixel_mm: float,
    border: Mask,
    changed: Mask,
    change: tuple[Floats, Floats],
    settings: ContactSettings,
) -> Mask:
    """The contact `touched` (rows, cols) without false regions; the deepest region stays.

    A true region has flanks: some of it is steep, and not where the `changed` part of the image
    ends, since a surface raised by drift ends there in a step. It stands out from its surroundings.
    At the image `border`, beyond which nothing holds the surface, it has a good part of the deepest
    region's depth: light is least known in the corners. And its flanks face opposite LEDs, so that
    each colour of the image's `change` (grey levels and their weights, each (rows, cols, 3)) rises
    on one and falls on the other; a spot of light changes all of it in one direction.
    """
    import cv2

    n, labels = cv2.connectedComponents(touched.astype(np.uint8), connectivity=8)
    if n <= 2:  # the background and one region
        return touched
    regions = np.asarray(labels, np.int32)
    depths = np.full(n, -np.inf, np.float32)
    np.maximum.at(depths, regions[touched], surface_mm[touched])
    depths = depths[1:]
    deepest = 1 + int(np.argmax(depths))
    slope = np.asarray(cv2.magnitude(*compute_slopes(surface_mm, pixel_mm)), np.float32)
    steepest = float(percentile(slope, 90.0, regions == deepest))
    steep = np.asarray(slope > min(settings.flank, settings.flank_of_deepest * steepest), np.bool_)
    steep &= _erode_inside(changed, settings.step_px)
    keep = np.bincount(regions[touched & steep], minlength=n) > settings.flank_share * np.bincount(
        regions.ravel(), minlength=n
    )
    cut = np.unique(regions[touched & border])
    keep[cut[depths[cut - 1] < settings.border_share * float(depths.max())]] = False
    keep[0] = keep[deepest] = False
    for k in np.flatnonzero(keep):
        region = np.equal(regions, k)
        keep[k] = _stands_out(
            region, touched, surface_mm, pixel_mm, settings
        ) and not _has_one_direction(change, region, pixel_mm, settings)
    keep[deepest] = True
    return np.asarray(keep[regions], np.bool_)


def _erode_inside(changed: Mask, step_px: int) -> Mask:
    """The pixels (rows, cols) farther from the end of `changed` than a smoothed step.

    The image border is no end.
    """
    import cv2

    kernel = np.ones((step_px, step_px), np.uint8)
    return np.asarray(cv2.erode(changed.astype(np.uint8), kernel, borderValue=1), np.bool_)


def _stands_out(
    region: Mask, touched: Mask, surface_mm: Floats, pixel_mm: float, settings: ContactSettings
) -> bool:
    """Whether a region is deeper than the untouched ring around it by a good part of its depth."""
    near_px, far_px = (
        max(1, round(mm / pixel_mm)) for mm in (settings.near_mm, settings.flanks_mm)
    )
    here = contact.find_box(region, far_px + near_px)
    ring = _dilate(region[here], far_px) & ~_dilate(touched[here], near_px)
    if not ring.any():
        return True
    depth_mm = median(surface_mm, region)
    return bool(depth_mm - median(surface_mm[here], ring) > settings.prominence * depth_mm)


def _has_one_direction(
    change: tuple[Floats, Floats], region: Mask, pixel_mm: float, settings: ContactSettings
) -> bool:
    """Whether the colours of a region and its surroundings all rise or all fall."""
    around = _dilate(region, max(1, round(settings.flanks_mm / pixel_mm)))
    seen = change[0][around] * change[1][around]
    return bool(np.abs(seen.sum(axis=0)).sum() > settings.one_direction * np.abs(seen).sum())


def _dilate(mask: Mask, by_px: int) -> Mask:
    import cv2

    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * by_px + 1, 2 * by_px + 1))
    return np.asarray(cv2.dilate(mask.astype(np.uint8), disc), np.bool_)
