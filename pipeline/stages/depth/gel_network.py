"""Depth of a gel by physics, corrected by the network that has learned where it errs on units that nobody calibrated.

The network looks at 120 x 160 pixels whatever the sensor has (`network_input`), so that its time does not depend on the
picture; what it adds is smooth, and what physics tells more finely stays. Where physics finds no contact, and for a
unit that is calibrated, its answer stands: neither was learned from.

The network that comes along (`training.gel_units`) has learned from units that differ as a lab's do, and tells how deep
all of a touch is as well: it answers where physics explains the light by a unit's lamps, and is believed where it says
more than physics, which loses steep walls, and not quite as far where it says less. Others have seen units of any light
and leave the scale to physics; weights that were taught on a unit's own presses (`training.own_unit`) correct its
look-up, and nothing else.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from pipeline.base.arrays import Floats, Image, Mask, freeze
from pipeline.base.memo import Memo
from pipeline.base.params import setting
from pipeline.base.progress import SILENT, Progress
from pipeline.base.stage_warnings import AT_BORDER, StageWarning
from pipeline.calibration.calibration_table import Calibration
from pipeline.engine.digests import content
from pipeline.networks.gel_depth_opencv import GelDepthNetworkOpenCv
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth import (
    adaptive_illumination,
    contact,
    draft_resolution,
    drift,
    gel_network_input,
    illumination_channels,
    photometric,
)
from pipeline.stages.depth.gel_depth import MeasuredSurface
from pipeline.values.frames import TactileFrame
from pipeline.values.results import DepthErrorModel, DepthMap

_SPECK_MM2 = 0.15  # smaller contacts are camera noise
_CORRELATION_PX = 8.0  # of the network's pixels: its errors go together over about what it integrates over
# The network's say in the scale, where that is more than physics' and where it is less: of 385 random presses on units
# that nothing was learned from, least squares give 1.0 to 2.0 for the one and 0.5 to 0.65 for the other. Where other
# touches of a recording tell the lamps as well, it is 1.1 and 0.24 (141 touches of six units).
_BELIEVED_MORE, _BELIEVED_LESS, _WEIGHT_BELOW_WITH_CONTEXT = 1.0, 0.6, 0.3
# Of what a network that tells the scale expects to be off by: what it was taught are means, which a few touches far off
# make. Of 163 such presses the logarithm's mean is that of 0.68; physics' error is told likewise (`depth_error`).
_MIDDLE = 0.68
_SURE = 2.0  # logit of what physics holds for contact, as the network has learned
_PUSHED_IN = (
    0.3  # of the nearest contact's depth, at its edge: half of it on a deep gel, less on a thin one (`contact`)
)


@dataclass(frozen=True, slots=True, kw_only=True)
class NetworkParams(photometric.DepthParams):
    """How physics looks at a gel's frame, and how the network's answer is taken."""

    smoothing_px: float = setting(
        1.0, "Smoothing", unit="px", low=0.0, high=5.0, step=0.25, help="blur of the colour change that physics reads",
        source="a Gaussian's standard deviation; how much is our own", only="gel",
    )  # fmt: skip
    certainty: float = setting(
        0.4, "Certainty of contact", unit="share", low=0.05, high=0.95, step=0.05,
        help="contact is where the network holds it for likelier than this",
source="measured: of 0.3, 0.4 and 0.5 the best overlap on simulated tools, which a limit of half of it makes largest",
    )  # fmt: skip


def estimate_depth(
    frame: TactileFrame,
    source: SensorSpec,
    calibration: Calibration | None,
    network: GelDepthNetworkOpenCv,
    params: NetworkParams,
    progress: Progress = SILENT,
) -> DepthMap:
    """Indentation, depth and contact of a gel's frame, with the error that the network itself expects.

    Raises what physics raises.
    """
    why = _not_for(calibration, for_units=network.calibrated)
    if why:
        found = photometric.estimate_depth_with_notes(frame, source, calibration, params, progress)
        return replace(found, notes=(*found.notes, why))
    photometric.check_frame(frame, source)
    by = photometric.compute_downsampling(frame, source, params)
    if by == 1:
        found = _by_both(frame, source, calibration, network, params, progress)
    else:
        seen_by = source if frame.camera is None else source.with_camera(frame.camera)
        small, less = draft_resolution.downsample_frame(frame, seen_by.camera, by), photometric.scale_params(params, by)
        light = photometric.get_cached_light(frame, source)
        found = _by_both(
            small, source, draft_resolution.downsample_calibration(calibration, by), network, less, progress, light
        )
        found = draft_resolution.upsample_depth(found, seen_by, by)
    return photometric.add_calibration_notes(found, frame, source, calibration)


def _by_both(
    frame: TactileFrame, source: SensorSpec, calibration: Calibration | None, network: GelDepthNetworkOpenCv,
    params: NetworkParams, progress: Progress, light: adaptive_illumination.Illumination | None = None,
) -> DepthMap:  # fmt: skip
    """Physics' answer, corrected where the network has something to say."""
    physical, measured, seen = estimate_physical_depth(frame, source, progress, calibration, params, light)
    if measured is None or not physical.contact.any():
        return physical
    progress.step(0.9, "correcting physics")
    seen_by = match_pixel_size(source if frame.camera is None else source.with_camera(frame.camera), calibration)
    why = illumination_channels.explain_exclusion(seen_by, measured.light) if network.predicts_depth_factor else ""
    if why:
        return replace(physical, notes=(*physical.notes, why))
    return correct_depth(
        physical, measured, seen, seen_by, network, params, has_context_frames=bool(frame.context_frames)
    )


def _not_for(calibration: Calibration | None, *, for_units: bool) -> str:
    """Why a network has nothing to correct of what a look-up reads; "" where it has."""
    if for_units and calibration is None:
        return StageWarning(
            "these weights correct the look-up of the unit that they were taught on: give it as --calibration"
        )
    if not for_units and calibration is not None and not calibration.is_built_in:
        return "the unit is calibrated: the network has nothing to correct"
    return ""


def match_pixel_size(source: SensorSpec, calibration: Calibration | None) -> SensorSpec:
    """The sensor with pixels as wide as a look-up has them."""
    if calibration is None or calibration.pixel_mm == source.pixel_mm:
        return source
    camera, share = source.camera, source.pixel_mm / calibration.pixel_mm
    return replace(source, camera=replace(camera, fx_px=share * camera.fx_px, fy_px=share * camera.fy_px))


def correct_depth(
    physical: DepthMap, measured: MeasuredSurface, seen: gel_network_input.NetworkInput, source: SensorSpec, network: GelDepthNetworkOpenCv,
    params: NetworkParams, *, has_context_frames: bool = False,
) -> DepthMap:  # fmt: skip
    """The physical answer with what the network makes of it; `source` as it is seen through the frame's camera.

    `lamps_told`: by other touches of the recording as well.
    """
    at = gel_network_input.make_grid(source.camera.shape)
    pixel_mm = np.float32(source.pixel_mm * at.pixels_per_cell)
    correction, more, spread, log_scale = _read(network, seen, source, measured.light)
    limit, told = math.log(params.certainty / (1.0 - params.certainty)), at.resample_to_image(more)
    likely = np.where(physical.contact, told > np.float32(limit - _SURE), told > np.float32(limit + _SURE))
    if log_scale is None:  # of any light, which may throw shadows beside a touch
        may = at.resample_to_image(_may_touch(measured.expand_to_frame(), seen, at).astype(np.float32)) > np.float32(
            0.5
        )
        likely &= physical.contact | may
    touched = contact.remove_specks(likely, max(4, round(_SPECK_MM2 / source.pixel_mm**2)))
    by_physics = measured.relax_outside_contact(touched)
    indentation = np.asarray(by_physics + at.resample_to_image(correction) * pixel_mm, np.float32)
    less = _WEIGHT_BELOW_WITH_CONTEXT if has_context_frames else _BELIEVED_LESS
    indentation *= _compute_depth_scale(indentation, by_physics, touched, log_scale, less)
    notes = _limited(indentation, touched, source)
    if not touched.any():
        notes.append("the network holds what has changed for no contact: nothing touches the sensor")
    return replace(
        physical,
        indentation_mm=freeze(indentation),
        depth_mm=freeze((source.rest_depth_mm - indentation).astype(np.float32)),
        contact=freeze(touched),
        notes=(*(note for note in physical.notes if note not in notes), *notes),
        error=_error(
            spread * np.float32(_MIDDLE if network.predicts_depth_factor else 1.0),
            at.resample_to_grid(touched.astype(np.float32)) > np.float32(0.5),
            float(pixel_mm),
        ),
        expected_error_mm=freeze(np.maximum(at.resample_to_image(spread), 0.0) * pixel_mm),
    )


def estimate_physical_depth(
    frame: TactileFrame,
    source: SensorSpec,
    progress: Progress = SILENT,
    calibration: Calibration | None = None,
    params: photometric.DepthParams | None = None,
    light: adaptive_illumination.Illumination | None = None,
) -> tuple[DepthMap, MeasuredSurface | None, gel_network_input.NetworkInput]:
    """The physical answer of a frame and what it was made of, and what the network sees of both.

    A `light` that is known to explain the picture is not looked for.
    """
    params = params or photometric.DepthParams()
    physical, measured = photometric.estimate_gel_depth(frame, source, calibration, params, progress, light)
    seen_by = match_pixel_size(source if frame.camera is None else source.with_camera(frame.camera), calibration)
    image, reference = cast("Image", frame.image), cast("Image", frame.reference)
    still = drift.apply_estimated_drift(image, reference).image
    lamps = _lights.of(content(seen_by), lambda: gel_network_input.describe_light(seen_by))
    return (
        physical,
        measured,
        gel_network_input.prepare_input(image, still, physical.indentation_mm, physical.contact, seen_by, lamps),
    )


_lights: Memo[str, gel_network_input.DescribedLight] = Memo(16)


def _read(
    network: GelDepthNetworkOpenCv,
    seen: gel_network_input.NetworkInput,
    source: SensorSpec,
    light: adaptive_illumination.Illumination | None,
) -> tuple[Floats, Floats, Floats, float | None]:
    """(correction in pixels, logit of contact beside physics', Laplace scale in pixels), each (120, 160).

    And the logarithm of the factor that makes the corrected surface true, of a network that tells one.
    """
    box = gel_network_input.FULL_BOX if network.predicts_depth_factor else gel_network_input.compute_contact_box(seen)
    deep = np.float32(gel_network_input.compute_depth_px(seen))
    shown = (
        illumination_channels.compute_all_channels(seen, source, light)
        if network.predicts_depth_factor
        else gel_network_input.compute_channels(seen, box)
    )
    told = network(shown)
    found = np.zeros((3, gel_network_input.ROWS, gel_network_input.COLS), np.float32)
    found[0][box] = deep * told.correction
    found[1][box] = told.contact_logit_correction
    found[2][box] = deep * np.exp(told.log_error_scale)
    return found[0], found[1], found[2], told.log_depth_factor


def _may_touch(surface_mm: Floats, seen: gel_network_input.NetworkInput, at: gel_network_input.InputGrid) -> Mask:
    """Where (120, 160) a contact may be beside the physical one: where the surface is pushed in as an edge is.

    Shadows and light that lamps throw beside a deep touch change the picture where the gel is hardly pushed in.
    """
    import cv2

    pressed = gel_network_input.compute_contact_mask(seen)
    deep = at.resample_to_grid(surface_mm)
    _, found = cv2.distanceTransformWithLabels((~pressed).astype(np.uint8), cv2.DIST_L2, 5)  # a label to each contact
    nearest = np.asarray(found, np.int32)
    depth_of = np.zeros(int(nearest.max()) + 1, np.float32)
    np.maximum.at(depth_of, nearest[pressed], deep[pressed])
    return pressed | (deep > np.float32(_PUSHED_IN) * depth_of[nearest])


def _compute_depth_scale(
    indentation: Floats, physical: Floats, touched: Mask, log_scale: float | None, less: float = _BELIEVED_LESS
) -> np.float32:
    """What brings a surface to its scale; 0 where no contact is left.

    That is physics', by least squares over the contact, where the network tells none: what one makes of it that was
    shown units of any light is what those were like (a tenth to a fifth of the depth, another share for every kind of
    sensor). Where it does, it lies between the two, nearer to the larger: they err by other things, physics by lamps
    that one touch hardly tells and by walls too steep for light, which make a touch too shallow, a network by how much
    its units are like this one. `less` is its say where it tells less than physics.
    """
    own = indentation[touched].astype(np.float64)
    # Sums, not products of vectors: whose threads go on waiting on the other core, which the next network needs.
    as_physics = float(np.sum(own * physical[touched])) / max(float(np.sum(own * own)), 1e-9)
    if log_scale is None or as_physics <= 0.0:
        return np.float32(as_physics)
    more = log_scale - math.log(as_physics)
    return np.float32(as_physics * math.exp((_BELIEVED_MORE if more > 0.0 else less) * more))


def _error(spread_px: Floats, touched: Mask, pixel_mm: float) -> DepthErrorModel | None:
    """What the network expects to be off by where it is touched: a Laplace scale b is a deviation of sqrt(2) b."""
    inside = spread_px[touched]
    if not inside.size:
        return None
    rms = math.sqrt(2.0 * float(np.mean(np.square(inside, dtype=np.float64)))) * pixel_mm
    return DepthErrorModel(rms_mm=rms, correlation_mm=_CORRELATION_PX * pixel_mm)


def _limited(indentation: Floats, touched: Mask, sensor: SensorSpec) -> list[str]:
    """Cut what is deeper than the sensor, in place; what is to be said of it."""
    notes: list[str] = []
    most = sensor.limits.indentation_max_mm
    beyond = int(np.count_nonzero(indentation > most))
    if beyond:
        notes.append(StageWarning(f"{beyond} pixels were deeper than the sensor's {most:g} mm and were cut to that"))
        np.minimum(indentation, np.float32(most), out=indentation)
    if touched[0].any() or touched[-1].any() or touched[:, 0].any() or touched[:, -1].any():
        notes.append(AT_BORDER)
    return notes
