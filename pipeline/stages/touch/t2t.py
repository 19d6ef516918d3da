"""Touch to touch, compact: the target's touch from the source's reading alone, learned from pairs; no depth between.

Of an object that it has never seen it may be sure of a body that is not there. One step, the likeliest touch, is
therefore drawn toward the physical render where it is unsure, for the time that this costs, and given up for it where
it contradicts what the source felt; without caution, and of samples, nothing but the network is asked.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from pipeline.base.arrays import Floats
from pipeline.base.errors import ShapeError
from pipeline.base.memo import Memo
from pipeline.base.progress import SILENT, Progress, SubProgress
from pipeline.base.stage_warnings import StageWarning, select_warnings
from pipeline.calibration.calibration_table import Calibration
from pipeline.engine.digests import compute_cached_digest
from pipeline.engine.graph import Method, Skipped
from pipeline.networks import network_factory, weights_registry
from pipeline.networks.weights import NoWeights, Weights
from pipeline.sensors.alignment import Alignment
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.cloud import back_projection as adaptation
from pipeline.stages.depth import network as depth_network
from pipeline.stages.depth import photometric as depth
from pipeline.stages.depth.gel_network import NetworkParams
from pipeline.stages.target_depth import surface_projection as projection
from pipeline.stages.touch import physical_render, t2d2
from pipeline.stages.touch.confidence_weighting import (
    compute_error_ratio,
    express_as_correction,
    read_error_calibration,
    shrink_to_prior,
)
from pipeline.stages.touch.depth_condition import make_working_sensor
from pipeline.stages.touch.depth_limit import check_depth_limit
from pipeline.stages.touch.image_condition import build_image_condition
from pipeline.stages.touch.residual_diffusion import DiffusionParams, sample_residual
from pipeline.stages.touch.residual_render import EdgeUncertainty, render_correction
from pipeline.values.frames import TactileFrame
from pipeline.values.results import DepthMap, GeneratedTouch

if TYPE_CHECKING:
    from torch import nn

SHIPPED_WEIGHTS = {("gelslim", "bubble"): "t2t_bubble", ("soft_bubble", "gel"): "t2t_gelslim"}
TASKS = "touch_to_touch", "pair_fine_tuning"  # tasks: pairs that were simulated, and real ones on top
_CONTRADICTED = 3.0  # times; of 70 touches that were not learned from five come to as much
NETWORK_ONLY_WARNING = "no contact is read from the picture: what touches here is what the network alone makes of it"
READS = ("frame", "source", "calibration", "alignment", "target")


def select_weights(source: SensorSpec, target: SensorSpec, file: Path | None) -> Weights | NoWeights:
    """The weights of a source and a target: only those two that pairs were learned from."""
    name = SHIPPED_WEIGHTS.get((source.name, target.kind))
    if file is None and (name is None or not t2d2.has_trained_pixel_size(target)):
        return NoWeights(why=f"no pairs of {source.title} and {target.title} were ever learned from")
    return weights_registry.load_for_task(TASKS, name or "", file)


def generate_touch(
    frame: TactileFrame,
    source: SensorSpec,
    calibration: Calibration | None,
    alignment: Alignment,
    target: SensorSpec,
    network: nn.Module,
    params: DiffusionParams,
    progress: Progress = SILENT,
) -> GeneratedTouch | Skipped:
    """What `target` would have recorded of the touch in `frame`; raises ShapeError for a frame that cannot be read.

    An untouched frame gives the untouched target and costs nothing; no denoising step gives the physical render.
    """
    depth.check_frame(frame, source)
    rest, seed = physical_render.make_reference_touch(target), params.seed if params.add_noise else None
    if depth.skip_without_contact(frame, source, calibration, depth.DepthParams()) is not None:
        return Skipped(output=rest, reason=physical_render.NO_CONTACT)
    careful = params.steps == 1 and params.confidence_weighting > 0.0
    physical = rest
    if careful or not params.steps:
        wanted = physical_render.PhysicalRenderParams(add_noise=params.add_noise, seed=params.seed)
        physical = _physical(frame, source, calibration, alignment, target, wanted, SubProgress(progress, 0.0, 0.8))
    if not params.steps:
        return physical
    asked = SubProgress(progress, 0.8, 0.2) if careful else progress
    found = sample_residual(
        network,
        build_condition(frame, source, alignment, target),
        params,
        asked,
        draw_last_noise=target.kind == "bubble",
    )
    membrane = physical.membrane
    if not careful or membrane is None or not membrane.contact.any():
        alone = (
            (StageWarning(NETWORK_ONLY_WARNING),) if careful else ()
        )  # what is said of a target at rest is not said of this touch
        made = render_correction(replace(rest, notes=alone), target, found, seed)
        return _doubted(made, frame, source, calibration, check_depth_limit(made, source, target, alignment))
    found = express_as_correction(found, membrane)
    times = compute_error_ratio(found, membrane.contact & physical.in_view)
    if times > _CONTRADICTED:
        note = (
            f"the network is {times:.0f} times farther than it expects from what was felt: the physical render answers"
        )
        return replace(physical, notes=(*physical.notes, note))
    found = shrink_to_prior(found, physical.in_view, params.confidence_weighting, read_error_calibration(network))
    return render_correction(physical, target, found, seed, _unsure(source, target, network))


def _unsure(source: SensorSpec, target: SensorSpec, network: nn.Module) -> EdgeUncertainty:
    """Where edges may be that a source told whose pixels are wider than the working grid's."""
    wide_mm = source.pixel_mm if source.pixel_mm > t2d2.WORKING_GRID_FACTOR[target.kind] * target.pixel_mm else 0.0
    blur_px, reach_px = cast("float", network.blur_px), cast("float", network.contact_margin_px)
    return EdgeUncertainty(blur_mm=wide_mm * blur_px, contact_margin_mm=wide_mm * reach_px)


def _doubted(
    touch: GeneratedTouch,
    frame: TactileFrame,
    source: SensorSpec,
    calibration: Calibration | None,
    also: tuple[StageWarning, ...],
) -> GeneratedTouch:
    """A touch that no depth lies behind, with what speaks against the source's picture, and against it `also`."""
    return replace(touch, notes=(*depth.warn_of_mismatch(frame, source, calibration), *also, *touch.notes))


def _physical(*reads: Any) -> GeneratedTouch:
    """The physical render by depth and view; the last few are kept, so that a dragged slider asks the network alone."""

    def render() -> GeneratedTouch:
        made = render_from_frame(*reads)
        return made.output if isinstance(made, Skipped) else made

    return _rendered.get_or_make(compute_cached_digest(reads[:-1]), render)


_rendered: Memo[str, GeneratedTouch] = Memo(4)


def build_condition(frame: TactileFrame, source: SensorSpec, alignment: Alignment, target: SensorSpec) -> Floats:
    """(channels, rows, cols) on the working grid; see `picture_input.of_picture`."""
    eye = source.camera if frame.camera is None else frame.camera
    reference: Any = frame.reference
    if reference is None:
        reference = source.with_camera(eye).render_reference()
    if reference.shape != frame.image.shape:
        raise ShapeError(f"the untouched reading must have the shape {frame.image.shape}, got {reference.shape}")
    change = source.sensor_kind.compute_change(frame.image, reference)
    return build_image_condition(change, eye, source, make_working_sensor(target), alignment)


def render_from_frame(
    frame: TactileFrame,
    source: SensorSpec,
    calibration: Calibration | None,
    alignment: Alignment,
    target: SensorSpec,
    params: physical_render.PhysicalRenderParams,
    progress: Progress = SILENT,
) -> GeneratedTouch | Skipped:
    """The touch by depth, cloud, view and physical render, each as it comes."""
    plain = depth.DepthParams()
    exact = depth.skip_without_contact(frame, source, calibration, plain)
    if exact is not None:
        return Skipped(output=physical_render.make_reference_touch(target), reason=physical_render.NO_CONTACT)
    felt = _felt(frame, source, calibration, SubProgress(progress, 0.0, 0.5))
    cloud = adaptation.skip_without_contact(felt, alignment, adaptation.BackProjectionParams())
    if cloud is None:
        cloud = adaptation.back_project_depth(felt, alignment, adaptation.BackProjectionParams())
    view = projection.project_cloud(cloud, target, projection.SurfaceProjectionParams())
    made = physical_render.render_touch(view, target, params, SubProgress(progress, 0.6, 0.4))
    return replace(made, notes=(*select_warnings((*felt.notes, *view.notes)), *made.notes))


def _felt(frame: TactileFrame, source: SensorSpec, calibration: Calibration | None, progress: Progress) -> DepthMap:
    reads = depth_network.select_weights(source, source, None)
    if isinstance(reads, NoWeights):
        return depth.estimate_depth_with_notes(frame, source, calibration, depth.DepthParams(), progress)
    return depth_network.estimate_depth(
        frame, source, calibration, network_factory.load_predictor(reads), NetworkParams(), progress
    )


PHYSICS_FROM_FRAME = Method(
    stage="touch",
    name="physics_from_frame",
    title="Physical render",
    help="depth, cloud, view and render in one",
    run=render_from_frame,
    params=physical_render.PhysicalRenderParams,
    reads=READS,
)
