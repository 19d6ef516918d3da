"""Depth of a gel: the photometric depth, corrected by a network trained on sensor instances that nobody calibrated.

The network sees 120 x 160 pixels whatever the sensor has (`gel_network_input`), so its time does not depend on the
image; its correction is smooth, and finer detail stays that of the photometric depth. Three cases are left to physics,
since the network was not trained on them: no physical contact, a calibrated sensor instance, and a light that physics
cannot explain by the instance's LEDs.

The network was trained on instances that differ as those of a lab do (`training.gel_instances`) and predicts the depth
of the whole touch as well. Physics underestimates steep walls, so the network's factor is taken fully where it is
larger than that of physics and in part where it is smaller.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from pipeline.base.arrays import Floats, Image, Mask, freeze
from pipeline.base.errors import AT_BORDER, StageWarning, UncertainContact
from pipeline.base.memo import Memo
from pipeline.base.params import setting
from pipeline.base.progress import SILENT, Progress, SubProgress
from pipeline.calibration.calibration_table import Calibration
from pipeline.engine.digests import compute_cached_digest
from pipeline.networks.gel_depth_prediction import PHYSICS_CONTACT_LOGIT, GelDepthPrediction
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth import (
    draft_resolution,
    gel_depth,
    gel_network_input,
    illumination_channels,
    photometric,
    regions,
)
from pipeline.stages.depth.gel_depth import MeasuredContact
from pipeline.stages.depth.illumination import gel_surface
from pipeline.stages.depth.illumination.light import Illumination
from pipeline.values.frames import TactileFrame
from pipeline.values.results import DepthErrorModel, DepthMap

GelNetwork = Callable[
    [Floats], tuple[Floats, ...]
]  # channels (28, 120, 160) -> `GelDepthPrediction` without batch axis
_SPECK_MM2 = 0.15  # smaller contacts are camera noise
_CORRELATION_PX = 8.0  # correlation length of the network's errors: about the length over which it integrates
# Weight of the network's log depth factor relative to physics, where it is larger and where it is smaller. Least
# squares over 385 random presses on instances outside the training data give 1.0 to 2.0 and 0.5 to 0.65; over 141
# touches of six instances whose LEDs other frames of the recording constrain, 1.1 and 0.24.
_WEIGHT_ABOVE, _WEIGHT_BELOW, _WEIGHT_BELOW_WITH_CONTEXT = 1.0, 0.6, 0.3
# Measured over predicted error (log mean over 163 of those presses): the prediction is a mean, which a few touches with
# large errors raise. `depth_error` states physics' error as a median, too.
_MEDIAN_ERROR_SHARE = 0.68


@dataclass(frozen=True, slots=True, kw_only=True)
class NetworkParams(photometric.DepthParams):
    """Parameters of the photometric depth, and the contact threshold of the network."""

    smoothing_px: float = setting(
        1.0, "Smoothing", unit="px", low=0.0, high=5.0, step=0.25, help="blur of the colour change",
        source="a Gaussian's standard deviation; its size is our choice", only="gel",
    )  # fmt: skip
    certainty: float = setting(
        0.4, "Contact probability", unit="share", low=0.05, high=0.95, step=0.05,
        help="pixels that the network holds for contact with a higher probability are contact",
        source="measured: best overlap on simulated tools of 0.3, 0.4 and 0.5",
    )  # fmt: skip


def estimate_depth(
    frame: TactileFrame,
    source: SensorSpec,
    calibration: Calibration | None,
    network: GelNetwork,
    params: NetworkParams,
    progress: Progress = SILENT,
) -> DepthMap:
    """Indentation, depth and contact of a gel's frame, with the error that the network predicts.

    Raises what the photometric depth raises.
    """
    if calibration is not None and not calibration.is_built_in:
        found = photometric.estimate_depth_with_notes(frame, source, calibration, params, progress)
        return replace(
            found, notes=(*found.notes, "this sensor is calibrated: the depth is photometric, without network")
        )
    photometric.check_frame(frame, source)
    factor = photometric.compute_downsampling(frame, source, params)
    if factor == 1:
        depth = _estimate(frame, source, calibration, network, params, progress)
    else:
        seen_by = source if frame.camera is None else source.with_camera(frame.camera)
        small = draft_resolution.downsample_frame(frame, seen_by.camera, factor)
        depth = _estimate(
            small, source, draft_resolution.downsample_calibration(calibration, factor), network,
            photometric.scale_params(params, factor), progress,
            photometric.estimate_illumination(frame, source, calibration, progress),
        )  # fmt: skip
        depth = draft_resolution.upsample_depth(depth, seen_by, factor)
    return photometric.add_calibration_notes(depth, frame, source, calibration)


def _estimate(
    frame: TactileFrame, source: SensorSpec, calibration: Calibration | None, network: GelNetwork,
    params: NetworkParams, progress: Progress, illumination: Illumination | None = None,
) -> DepthMap:  # fmt: skip
    """The photometric depth, corrected where the network applies."""
    physical, measured = photometric.estimate_gel_depth(
        frame, source, calibration, params, SubProgress(progress, 0.0, 0.9), illumination
    )
    if measured is None or not physical.contact.any():
        return physical
    progress.step(0.9, "correcting by the network")
    seen_by = match_pixel_size(source if frame.camera is None else source.with_camera(frame.camera), calibration)
    reason = illumination_channels.explain_exclusion(seen_by, measured.illumination)
    if (
        calibration is not None
        and calibration.depth_scale_map is not None
        and gel_depth.NOT_SCALED not in physical.notes
    ):
        reason = reason or "presses of a ball scale the depth here: the result is that of physics alone"
    if reason:
        return replace(physical, notes=(*physical.notes, reason))
    inputs = prepare_input(frame, seen_by, physical)
    return correct_depth(
        physical, measured, inputs, seen_by, network, params, has_context_frames=bool(frame.context_frames)
    )


def match_pixel_size(source: SensorSpec, calibration: Calibration | None) -> SensorSpec:
    """The sensor with the pixel width of a calibration."""
    if calibration is None or calibration.pixel_mm == source.pixel_mm:
        return source
    camera, share = source.camera, source.pixel_mm / calibration.pixel_mm
    return replace(source, camera=replace(camera, fx_px=share * camera.fx_px, fy_px=share * camera.fy_px))


def correct_depth(
    physical: DepthMap, measured: MeasuredContact, inputs: gel_network_input.NetworkInput, source: SensorSpec,
    network: GelNetwork, params: NetworkParams, *, has_context_frames: bool = False,
) -> DepthMap:  # fmt: skip
    """The photometric depth with the network's correction; `source` with the frame's own camera.

    `has_context_frames`: other frames of the recording constrain the LEDs as well.
    """
    grid = gel_network_input.make_grid(source.camera.shape)
    cell_mm = np.float32(source.pixel_mm * grid.pixels_per_cell)
    unit_px = np.float32(gel_network_input.compute_depth_px(inputs))  # unit of the network's lengths
    channels = illumination_channels.compute_all_channels(inputs, source, measured.illumination)
    prediction = GelDepthPrediction(*network(channels))
    limit = math.log(params.certainty / (1.0 - params.certainty))
    logit = grid.resample_to_image(prediction.contact_logit_correction)
    likely = logit > np.float32(limit) + np.where(
        physical.contact, np.float32(-PHYSICS_CONTACT_LOGIT), np.float32(PHYSICS_CONTACT_LOGIT)
    )
    touched = regions.remove_specks(likely, max(4, round(_SPECK_MM2 / source.pixel_mm**2)))
    relaxed = measured.gel.compute_indentation(touched)
    correction = grid.resample_to_image(unit_px * prediction.correction)
    indentation = np.asarray(relaxed + correction * cell_mm, np.float32)
    below = _WEIGHT_BELOW_WITH_CONTEXT if has_context_frames else _WEIGHT_BELOW
    indentation *= _compute_depth_scale(indentation, relaxed, touched, float(prediction.log_depth_factor), below)
    notes = _limit_indentation(indentation, touched, source)
    if not touched.any():
        notes.append(UncertainContact("contact uncertain: the network finds none where the image has changed"))
    error_px = unit_px * np.exp(prediction.log_error_scale)
    in_contact = grid.resample_to_grid(touched.astype(np.float32)) > np.float32(0.5)
    return replace(
        physical,
        indentation_mm=freeze(indentation),
        depth_mm=freeze((source.rest_depth_mm - indentation).astype(np.float32)),
        contact=freeze(touched),
        notes=(*(note for note in physical.notes if note not in notes), *notes),
        error=_build_error_model(error_px[in_contact] * np.float32(_MEDIAN_ERROR_SHARE), float(cell_mm)),
        expected_error_mm=freeze(np.maximum(grid.resample_to_image(error_px), 0.0) * cell_mm),
    )


def estimate_physical_depth(
    frame: TactileFrame, source: SensorSpec
) -> tuple[DepthMap, MeasuredContact | None, gel_network_input.NetworkInput]:
    """The photometric depth of a frame without calibration, the surface it was made of, and the network's input."""
    physical, measured = photometric.estimate_gel_depth(frame, source, None, photometric.DepthParams())
    seen_by = source if frame.camera is None else source.with_camera(frame.camera)
    return physical, measured, prepare_input(frame, seen_by, physical)


def prepare_input(frame: TactileFrame, source: SensorSpec, physical: DepthMap) -> gel_network_input.NetworkInput:
    """The network's input from a frame and its photometric depth; `source` with the frame's own camera."""
    image, reference = cast("Image", frame.image), cast("Image", frame.reference)
    reference = gel_surface.observe(image, reference, source, source.pixel_mm, frame.context_frames).rest.image
    described = _described_lights.get_or_make(
        compute_cached_digest(source), lambda: gel_network_input.describe_light(source)
    )
    return gel_network_input.prepare_input(
        image, reference, physical.indentation_mm, physical.contact, source, described
    )


_described_lights: Memo[str, gel_network_input.DescribedLight] = Memo(16)


def _compute_depth_scale(
    indentation: Floats, physical: Floats, touched: Mask, log_factor: float, weight_below: float = _WEIGHT_BELOW
) -> np.float32:
    """The factor that brings a corrected surface to its depth; 0 where no contact is left.

    It lies between two estimates: that of physics (least squares to the physical surface in contact), which errs by
    LEDs that one touch hardly constrains and by walls too steep for the light, and the network's, which errs by how
    much this instance differs from those of the training data. `weight_below` weighs the network's where it is smaller.
    """
    own = indentation[touched].astype(np.float64)
    # Sums instead of vector products: BLAS threads spin on the other core, which the next network needs.
    of_physics = float(np.sum(own * physical[touched])) / max(float(np.sum(own * own)), 1e-9)
    if of_physics <= 0.0:
        return np.float32(of_physics)
    log_ratio = log_factor - math.log(of_physics)
    return np.float32(of_physics * math.exp((_WEIGHT_ABOVE if log_ratio > 0.0 else weight_below) * log_ratio))


def _build_error_model(error_px: Floats, cell_mm: float) -> DepthErrorModel | None:
    """The error in contact from Laplace scales b there (standard deviation sqrt(2) b); None without contact."""
    if not error_px.size:
        return None
    rms = math.sqrt(2.0 * float(np.mean(np.square(error_px, dtype=np.float64)))) * cell_mm
    return DepthErrorModel(rms_mm=rms, correlation_mm=_CORRELATION_PX * cell_mm)


def _limit_indentation(indentation: Floats, touched: Mask, sensor: SensorSpec) -> list[str]:
    """Clip indentation above the sensor's limit, in place; returns the notes."""
    notes: list[str] = []
    limit_mm = sensor.limits.indentation_max_mm
    beyond = int(np.count_nonzero(indentation > limit_mm))
    if beyond:
        notes.append(
            StageWarning(f"{beyond} pixels were deeper than the sensor's {limit_mm:g} mm and were clipped to it")
        )
        np.minimum(indentation, np.float32(limit_mm), out=indentation)
    if touched[0].any() or touched[-1].any() or touched[:, 0].any() or touched[:, -1].any():
        notes.append(AT_BORDER)
    return notes
