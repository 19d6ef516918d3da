"""T2T, compact: the target's touch directly from the source frame, trained on sensor pairs, without depth in between.

On an unseen object the network may be confident of a contact that does not exist. The posterior mean (one step) is
therefore shrunk toward the physical render by its uncertainty, which costs the time of that render, and replaced by it
where it contradicts the source's contact. Without confidence weighting, and for samples, only the network runs.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from pipeline.base.arrays import Floats
from pipeline.base.errors import ShapeError
from pipeline.base.progress import SILENT, Progress, SubProgress
from pipeline.calibration.calibration_table import Calibration
from pipeline.engine.graph import Fallback
from pipeline.networks import weights_registry
from pipeline.networks.first_pass import ResidualNetwork
from pipeline.networks.touch_formats import answer_for_known_kinds, get_touch_format
from pipeline.networks.weights import NoWeights, Weights
from pipeline.physics.sensor_images import render_reference
from pipeline.sensors.alignment import Alignment
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth import photometric as depth
from pipeline.stages.touch import frame_chain, physical_render, t2d2
from pipeline.stages.touch.confidence_weighting import (
    compute_error_ratio,
    express_as_correction,
    read_error_calibration,
    shrink_to_prior,
)
from pipeline.stages.touch.depth_condition import make_working_sensor
from pipeline.stages.touch.image_condition import build_image_condition
from pipeline.stages.touch.residual_diffusion import DiffusionParams, sample_residual
from pipeline.stages.touch.residual_render import NO_PRIOR_CONTACT, NO_STEPS, render_correction, report_change
from pipeline.stages.touch.touch_from_change import check_depth_limit
from pipeline.values.frames import TactileFrame
from pipeline.values.results import GeneratedTouch, TargetDepth

SHIPPED_WEIGHTS = {("gelslim", "bubble"): "t2t_bubble", ("soft_bubble", "gel"): "t2t_gelslim"}
TASK = "touch_to_touch"
_MAX_ERROR_RATIO = 3.0  # error over expected error; 5 of 70 held-out touches exceed it


@answer_for_known_kinds
def select_weights(source: SensorSpec, target: SensorSpec, file: Path | None) -> Weights | NoWeights:
    """The weights of a source and a target sensor: only trained pairs."""
    name = SHIPPED_WEIGHTS.get((source.name, target.kind))
    if file is None and (name is None or not t2d2.has_trained_pixel_size(target)):
        return NoWeights(why=f"the shipped weights are not trained on pairs of {source.title} and {target.title}")
    found = weights_registry.load_for_task(TASK, name or "", file, target_kind=target.kind)
    if isinstance(found, Weights) and found.config.get("inputs") != get_touch_format(source.kind).resampled_channels:
        return NoWeights(why=f"the weights {found.name!r} do not translate from a {source.kind}; choose others")
    return found


def generate_touch(
    frame: TactileFrame,
    source: SensorSpec,
    calibration: Calibration | None,
    alignment: Alignment,
    target: SensorSpec,
    view: TargetDepth,
    network: ResidualNetwork,
    params: DiffusionParams,
    progress: Progress = SILENT,
) -> GeneratedTouch | Fallback[GeneratedTouch]:
    """Generate what `target` would record of the touch in `frame`; raises ShapeError for an invalid frame.

    The frame is in contact (`frame_chain.guard_contact`). No denoising step gives the physical render. Weights of
    recorded pairs answer alone.
    """
    is_recorded = bool(getattr(network, "trained_on_recordings", False))
    is_weighted = params.steps == 1 and params.confidence_weighting > 0.0 and not is_recorded
    seed = params.seed if params.add_noise else None
    physical = physical_render.make_reference_touch(target)
    if is_weighted or not params.steps:
        render_params = physical_render.PhysicalRenderParams(add_noise=params.add_noise, seed=params.seed)
        physical = frame_chain.render_view(view, target, render_params, SubProgress(progress, 0.0, 0.8))
    membrane = physical.membrane
    if not params.steps or membrane is None:
        return Fallback(result=physical, reason=NO_STEPS)
    if is_weighted and not membrane.contact.any():
        return Fallback(result=physical, reason=NO_PRIOR_CONTACT)
    sample = sample_residual(
        network,
        build_condition(frame, source, alignment, target),
        params,
        SubProgress(progress, 0.8, 0.2) if is_weighted else progress,
        draw_last_noise=target.sensor_kind.is_depth,
    )
    if not is_weighted:
        touch = render_correction(replace(physical, notes=()), target, sample, seed)
        warnings = depth.warn_of_mismatch(frame, source, calibration)
        limits = () if is_recorded else check_depth_limit(touch, source, target, alignment)
        return replace(touch, notes=(*warnings, *limits, *touch.notes))
    sample = express_as_correction(sample, membrane)
    error_ratio = compute_error_ratio(sample, membrane.contact & physical.in_view)
    if error_ratio > _MAX_ERROR_RATIO:
        why = f"it deviates from the measured contact by {error_ratio:.0f} times its expected error"
        return Fallback(result=physical, reason=f"physics: the network contradicts the source; {why}")
    sample = shrink_to_prior(sample, physical.in_view, params.confidence_weighting, read_error_calibration(network))
    return report_change(render_correction(physical, target, sample, seed), physical)


def build_condition(frame: TactileFrame, source: SensorSpec, alignment: Alignment, target: SensorSpec) -> Floats:
    """(channels, rows, cols) on the working grid; see `image_condition.build_image_condition`."""
    camera = source.camera if frame.camera is None else frame.camera
    reference: Any = frame.reference
    if reference is None:
        reference = render_reference(source.with_camera(camera))
    if reference.shape != frame.image.shape:
        raise ShapeError(f"the reference image must have the shape {frame.image.shape}, got {reference.shape}")
    change = source.sensor_kind.compute_change(frame.image, reference)
    return build_image_condition(change, camera, source, make_working_sensor(target), alignment)
