"""Touch to depth to touch, compact: the physical render of the view, and the residual that a denoiser samples on it.

What a bubble feels beside what a gel felt is no matter of physics but of knowing objects; the network has seen many,
as the target itself feels them, and no pair of two sensors. With no step at all physics remains, to the byte.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np

from pipeline.base.arrays import Floats
from pipeline.base.memo import Memo
from pipeline.base.progress import SILENT, Progress, SubProgress
from pipeline.engine.digests import compute_cached_digest
from pipeline.networks import weights_registry
from pipeline.networks.weights import NoWeights, Weights
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.touch import physical_render
from pipeline.stages.touch.confidence_weighting import read_error_calibration, shrink_to_prior
from pipeline.stages.touch.depth_condition import WORKING_GRID_FACTOR, build_depth_condition, make_working_sensor
from pipeline.stages.touch.physical_render import PhysicalRenderParams
from pipeline.stages.touch.residual_diffusion import DiffusionParams, sample_residual
from pipeline.stages.touch.residual_render import EdgeUncertainty, render_correction, resample_to_grid
from pipeline.values.results import DepthMap, GeneratedTouch, TargetDepth

if TYPE_CHECKING:
    from torch import nn

SHIPPED_WEIGHTS = {"bubble": "t2d2_bubble", "gel": "t2d2_gelslim"}
TRAINED_PIXEL_MM = {"bubble": 0.43, "gel": 0.0843}  # of the working grid
MAX_PIXEL_RATIO = 1.25  # how much finer or coarser a target may be
_HALF = 0.5


def select_weights(source: SensorSpec, target: SensorSpec, file: Path | None) -> Weights | NoWeights:  # noqa: ARG001 - any source
    """The weights of a target; whatever the source: none was ever learned from."""
    found = weights_registry.load_for_task("touch_residual", SHIPPED_WEIGHTS[target.kind], file)
    return (
        found
        if file is not None
        else found
        if has_trained_pixel_size(target)
        else NoWeights(why=explain_misfit(target))
    )


def has_trained_pixel_size(target: SensorSpec) -> bool:
    """Whether the target's pixels are about as large as those that were learned on."""
    return 1 / MAX_PIXEL_RATIO < make_working_sensor(target).pixel_mm / TRAINED_PIXEL_MM[target.kind] < MAX_PIXEL_RATIO


def explain_misfit(target: SensorSpec) -> str:
    """Why no weights that come along suit a target."""
    learned = TRAINED_PIXEL_MM[target.kind]
    return f"pixels of {make_working_sensor(target).pixel_mm:.3g} mm are not those of {learned:g} mm that the network knows"


def skip_without_contact(
    view: TargetDepth,
    target: SensorSpec,
    weights: Weights | NoWeights,  # noqa: ARG001 - the method's arguments
    params: DiffusionParams,  # noqa: ARG001 - the method's arguments
) -> GeneratedTouch | None:
    """The target's untouched reading when the view has no contact, else None: no weights are looked at."""
    return physical_render.skip_without_contact(view, target, PhysicalRenderParams())


def generate_touch(
    view: TargetDepth, target: SensorSpec, network: nn.Module, params: DiffusionParams, progress: Progress = SILENT
) -> GeneratedTouch:
    """What `target` would have recorded of `view`; raises ShapeError when the view is of another image size."""
    rendering = SubProgress(progress, 0.0, 0.3) if params.steps else progress
    physical = _render(view, target, PhysicalRenderParams(add_noise=params.add_noise, seed=params.seed), rendering)
    at_first = physical.membrane
    if not params.steps or at_first is None or not at_first.contact.any():
        return physical
    learned = target.kind == "bubble"
    found = sample_residual(
        network,
        build_condition(view, at_first, target),
        params,
        SubProgress(progress, 0.3, 0.7),
        draw_last_noise=learned,
    )
    if learned:  # a gel that felt the object did so for certain
        felt = np.where(
            resample_to_grid(view.contact, make_working_sensor(target).camera.shape) > _HALF, 1.0, 0.0
        ).astype(np.float32)
        found = replace(
            found, final=replace(found.final, contact_correction=np.maximum(found.final.contact_correction, felt))
        )
    beyond = found.expected_error_mm[resample_to_grid(view.in_view, found.expected_error_mm.shape) < _HALF]
    told = float((beyond if beyond.size else found.expected_error_mm).mean())
    where = "beyond what the source felt" if beyond.size else "all over"
    wide_mm = 0.0
    if params.steps == 1:  # a sample is one of many: all of it, and as sharp as it is
        # Of a gel, physics knows contact better: overlap 0.696, not 0.692, of 78 touches that are in no table.
        found = shrink_to_prior(
            found, view.in_view, params.confidence_weighting, read_error_calibration(network), shrinks_contact=learned
        )
        wide_mm = _told_mm(view, target)
    note = f"{where} the touch is learned, and expected to be off by {told:.2g} mm"
    found = replace(found, notes=(*found.notes, note))
    blur_px, reach_px = cast("float", network.blur_px), cast("float", network.contact_margin_px)
    unsure = EdgeUncertainty(blur_mm=wide_mm * blur_px, contact_margin_mm=wide_mm * reach_px)
    return render_correction(physical, target, found, params.seed if params.add_noise else None, unsure)


def _told_mm(view: TargetDepth, target: SensorSpec) -> float:
    """How wide a pixel of the source is on the target's plane; 0 where it is finer than the working grid."""
    points = view.source_index[view.contact]
    told = np.unique(points[points >= 0]).size
    wide_px = math.sqrt(points.size / told) if told else 1.0
    return wide_px * target.pixel_mm if wide_px > WORKING_GRID_FACTOR[target.kind] else 0.0


def _render(view: TargetDepth, target: SensorSpec, params: PhysicalRenderParams, progress: Progress) -> GeneratedTouch:
    """The physical render; the last few are kept, so that a dragged slider costs passes of the network alone."""
    key = compute_cached_digest(view), compute_cached_digest(target), params
    return _rendered.get_or_make(key, lambda: physical_render.render_touch(view, target, params, progress))


_rendered: Memo[tuple[str, str, PhysicalRenderParams], GeneratedTouch] = Memo(4)


def build_condition(view: TargetDepth, physical: DepthMap, target: SensorSpec) -> Floats:
    """(channels, rows, cols) on the working grid; see `residual_input.of_view`."""
    shape = make_working_sensor(target).camera.shape
    share = resample_to_grid(view.contact, shape)
    told = resample_to_grid(np.where(view.contact, view.indentation_mm, np.float32(0.0)), shape) / np.maximum(
        share, 1e-6
    )
    felt = share > _HALF
    return build_depth_condition(
        target.kind, np.where(felt, told, 0.0).astype(np.float32), felt, resample_to_grid(view.in_view, shape) > _HALF,
        resample_to_grid(physical.indentation_mm, shape), resample_to_grid(physical.contact, shape) > _HALF,
    )  # fmt: skip
