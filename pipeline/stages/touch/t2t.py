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
from pipeline.base.errors import ShapeError, StageWarning, select_warnings
from pipeline.base.memo import Memo
from pipeline.base.progress import SILENT, Progress, SubProgress
from pipeline.calibration.calibration_table import Calibration
from pipeline.engine.digests import compute_cached_digest
from pipeline.engine.graph import Fallback, Method, Skipped
from pipeline.networks import network_factory, weights_registry
from pipeline.networks.first_pass import ResidualNetwork
from pipeline.networks.touch_formats import answer_for_known_kinds, get_touch_format
from pipeline.networks.weights import NoWeights, Weights
from pipeline.sensors.alignment import Alignment
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.cloud import back_projection as adaptation
from pipeline.stages.depth import bubble_network
from pipeline.stages.depth import photometric as depth
from pipeline.stages.target_depth import surface_projection as projection
from pipeline.stages.touch import physical_render, t2d2
from pipeline.stages.touch.confidence_weighting import (
    compute_error_ratio,
    express_as_correction,
    read_error_calibration,
    shrink_to_prior,
)
from pipeline.stages.touch.depth_condition import make_working_sensor
from pipeline.stages.touch.image_condition import build_image_condition
from pipeline.stages.touch.residual_diffusion import DiffusionParams, sample_residual
from pipeline.stages.touch.residual_render import render_correction, report_change
from pipeline.stages.touch.touch_from_change import check_depth_limit
from pipeline.values.frames import TactileFrame
from pipeline.values.results import DepthMap, GeneratedTouch

SHIPPED_WEIGHTS = {("gelslim", "bubble"): "t2t_bubble", ("soft_bubble", "gel"): "t2t_gelslim"}
TASK = "touch_to_touch"
_MAX_ERROR_RATIO = 3.0  # error over expected error; 5 of 70 held-out touches exceed it
NETWORK_ONLY_WARNING = (
    "physics finds no contact in the source image: this contact is the network's alone; check the source"
)
READS = ("frame", "source", "calibration", "alignment", "target")


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
    network: ResidualNetwork,
    params: DiffusionParams,
    progress: Progress = SILENT,
) -> GeneratedTouch | Skipped | Fallback[GeneratedTouch]:
    """Generate what `target` would record of the touch in `frame`; raises ShapeError for an invalid frame.

    A frame without contact gives the reference touch at no cost; no denoising step gives the physical render. Weights
    of recorded pairs answer alone.
    """
    depth.check_frame(frame, source)
    rest, seed = physical_render.make_reference_touch(target), params.seed if params.add_noise else None
    if depth.skip_without_contact(frame, source, calibration, depth.DepthParams()) is not None:
        return physical_render.skip_to_reference_touch(target)
    is_weighted = params.steps == 1 and params.confidence_weighting > 0.0
    is_weighted &= not getattr(network, "trained_on_recordings", False)
    physical = rest
    if is_weighted or not params.steps:
        render_params = physical_render.PhysicalRenderParams(add_noise=params.add_noise, seed=params.seed)
        physical = _render_cached(
            frame, source, calibration, alignment, target, render_params, SubProgress(progress, 0.0, 0.8)
        )
    if not params.steps:
        return physical
    sampling_progress = SubProgress(progress, 0.8, 0.2) if is_weighted else progress
    sample = sample_residual(
        network,
        build_condition(frame, source, alignment, target),
        params,
        sampling_progress,
        draw_last_noise=target.sensor_kind.is_depth,
    )
    membrane = physical.membrane
    if not is_weighted or membrane is None or not membrane.contact.any():
        network_warnings = (
            (StageWarning(NETWORK_ONLY_WARNING),) if is_weighted else ()
        )  # replaces the notes of the reference touch
        touch = render_correction(replace(rest, notes=network_warnings), target, sample, seed)
        warnings = depth.warn_of_mismatch(frame, source, calibration)
        limits = check_depth_limit(touch, source, target, alignment)
        return replace(touch, notes=(*warnings, *limits, *touch.notes))
    sample = express_as_correction(sample, membrane)
    error_ratio = compute_error_ratio(sample, membrane.contact & physical.in_view)
    if error_ratio > _MAX_ERROR_RATIO:
        why = f"it deviates from the measured contact by {error_ratio:.0f} times its expected error"
        return Fallback(result=physical, reason=f"physics: the network contradicts the source; {why}")
    sample = shrink_to_prior(sample, physical.in_view, params.confidence_weighting, read_error_calibration(network))
    return report_change(render_correction(physical, target, sample, seed), physical)


def _render_cached(*reads: Any) -> GeneratedTouch:
    """The physical render from the frame, cached: a dragged slider then costs network passes only."""

    def render() -> GeneratedTouch:
        touch = render_from_frame(*reads)
        return touch.output if isinstance(touch, Skipped) else touch

    return _rendered.get_or_make(compute_cached_digest(reads[:-1]), render)


_rendered: Memo[str, GeneratedTouch] = Memo(4)


def build_condition(frame: TactileFrame, source: SensorSpec, alignment: Alignment, target: SensorSpec) -> Floats:
    """(channels, rows, cols) on the working grid; see `image_condition.build_image_condition`."""
    camera = source.camera if frame.camera is None else frame.camera
    reference: Any = frame.reference
    if reference is None:
        reference = source.with_camera(camera).render_reference()
    if reference.shape != frame.image.shape:
        raise ShapeError(f"the reference image must have the shape {frame.image.shape}, got {reference.shape}")
    change = source.sensor_kind.compute_change(frame.image, reference)
    return build_image_condition(change, camera, source, make_working_sensor(target), alignment)


def render_from_frame(
    frame: TactileFrame,
    source: SensorSpec,
    calibration: Calibration | None,
    alignment: Alignment,
    target: SensorSpec,
    params: physical_render.PhysicalRenderParams,
    progress: Progress = SILENT,
) -> GeneratedTouch | Skipped:
    """The touch by depth, cloud, target depth and physical render, with default parameters."""
    depth_params = depth.DepthParams()
    skipped = depth.skip_without_contact(frame, source, calibration, depth_params)
    if skipped is not None:
        return physical_render.skip_to_reference_touch(target)
    depth_map = _estimate_depth(frame, source, calibration, SubProgress(progress, 0.0, 0.5))
    cloud = adaptation.skip_without_contact(depth_map, alignment, adaptation.BackProjectionParams())
    if cloud is None:
        cloud = adaptation.back_project_depth(depth_map, alignment, adaptation.BackProjectionParams())
    view = projection.project_cloud(cloud, target, projection.SurfaceProjectionParams())
    touch = physical_render.render_touch(view, target, params, SubProgress(progress, 0.6, 0.4))
    return replace(touch, notes=(*select_warnings((*depth_map.notes, *view.notes)), *touch.notes))


def _estimate_depth(
    frame: TactileFrame, source: SensorSpec, calibration: Calibration | None, progress: Progress
) -> DepthMap:
    weights = bubble_network.select_weights(source, source, None) if source.kind == "bubble" else NoWeights(why="")
    if isinstance(weights, NoWeights):
        return depth.estimate_depth_with_notes(frame, source, calibration, depth.DepthParams(), progress)
    return bubble_network.estimate_frame(
        frame, source, calibration, network_factory.load_predictor(weights), bubble_network.NetworkParams(), progress
    )


PHYSICS_FROM_FRAME = Method(
    stage="touch",
    name="physics_from_frame",
    title="Physical render",
    help="depth, cloud, target depth and render in one",
    run=render_from_frame,
    params=physical_render.PhysicalRenderParams,
    reads=READS,
)
