"""T2T, compact: a bubble's touch directly from a gel's frame, trained on sensor pairs, without
depth in between.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.calibration.calibration_table import Calibration
from pipeline.core.arrays import Floats
from pipeline.core.errors import ShapeError
from pipeline.core.graph import Fallback
from pipeline.core.progress import SILENT, Progress
from pipeline.core.values.frames import TactileFrame
from pipeline.core.values.results import DepthMap, GeneratedTouch, TargetDepth
from pipeline.physics import optics
from pipeline.physics.sensor_images import render_reference
from pipeline.sensors.alignment import Alignment
from pipeline.sensors.spec import SensorSpec, load_sensor
from pipeline.stages.depth import photometric as depth
from pipeline.stages.networks import weights_registry
from pipeline.stages.networks.touch_formats import answer_for_known_kinds
from pipeline.stages.networks.weights import NoWeights, Weights
from pipeline.stages.touch import frame_chain, physical_render, t2d2
from pipeline.stages.touch.frame_chain import check_depth_limit
from pipeline.stages.touch.image_condition import IMAGE_CHANNELS, build_image_condition
from pipeline.stages.touch.moved_touch import (
    find_motion,
    get_trained_alignment,
    press_moved_touch,
)
from pipeline.stages.touch.residual_diffusion import (
    NO_STEPS,
    DiffusionParams,
    render_correction,
    sample_residual,
)
from pipeline.stages.touch.t2d2 import make_working_sensor

SHIPPED_WEIGHTS = "t2t_bubble"
TRAINED_SOURCE = "gelslim"
TASK = "touch_to_touch"


@answer_for_known_kinds
def select_weights(
    source: SensorSpec, target: SensorSpec, file: Path | None
) -> Weights | NoWeights:
    """The weights of a bubble, from any gel."""
    if source.sensor_kind.is_depth or not target.sensor_kind.is_depth:
        why = (
            f"T2T translates from a gel to a bubble, not from a {source.kind} to a "
            f"{target.kind}; choose another"
        )
        return NoWeights(why=why)
    if file is None and not t2d2.has_trained_pixel_size(target):
        return NoWeights(why=t2d2.explain_misfit(target))
    return weights_registry.load_for_task(TASK, SHIPPED_WEIGHTS, file, target_kind=target.kind)


def generate_touch(
    frame: TactileFrame,
    source_depth: DepthMap,
    source: SensorSpec,
    calibration: Calibration | None,
    alignment: Alignment,
    target: SensorSpec,
    view: TargetDepth,
    network: Any,  # ResidualNetwork
    params: DiffusionParams,
    progress: Progress = SILENT,
) -> GeneratedTouch | Fallback[GeneratedTouch]:
    """Generate what `target` would record of the touch in `frame`.

    Raises ShapeError for an invalid frame.

    The frame is in contact (`frame_chain.guard_contact`). No denoising step gives the physical
    render, and so does a touch deeper than the source can be pressed.
    """
    render_params = physical_render.PhysicalRenderParams(
        add_noise=params.add_noise, seed=params.seed
    )

    def answer_by_physics(reason: str) -> Fallback[GeneratedTouch]:
        return Fallback(
            result=frame_chain.render_view(view, target, render_params, progress), reason=reason
        )

    if not params.steps:
        return answer_by_physics(NO_STEPS)
    knows_placement = network.inputs == IMAGE_CHANNELS or network.trained_on_recordings
    trained = alignment if knows_placement else get_trained_alignment(source)
    is_known = knows_placement or source.name == TRAINED_SOURCE
    shown = frame if is_known else render_as_trained(source_depth, source)
    condition = build_condition(shown, source, trained, target)[: int(network.inputs)]
    at_rest = replace(physical_render.make_reference_touch(target), notes=())

    def generate(sampling: DiffusionParams) -> GeneratedTouch:
        sample = sample_residual(
            network, condition, sampling, progress, draw_last_noise=target.sensor_kind.is_depth
        )
        seed = sampling.seed if sampling.add_noise else None
        return render_correction(at_rest, target, sample, seed)

    warnings = depth.warn_of_mismatch(frame, source, calibration)
    mean_params = replace(params, steps=1, guidance=1.0, keep_states=False)
    touch = generate(mean_params)  # shows what is impossible before a sampling is paid for
    is_recorded = network.trained_on_recordings
    limits = () if is_recorded else check_depth_limit(touch, source, target, trained)
    if limits:
        return answer_by_physics(f"physics: {limits[0].partition(';')[0]}")
    touch = touch if params == mean_params else generate(params)
    motion = find_motion(trained, alignment)
    if motion is not None:
        touch = press_moved_touch(touch, motion, view, target, render_params, progress)
    return replace(touch, notes=(*warnings, *touch.notes))


def render_as_trained(depth: DepthMap, source: SensorSpec) -> TactileFrame:
    """What the gel that the network knows would show of the depth that another one measured."""
    known = load_sensor(TRAINED_SOURCE)
    lit = replace(source.with_camera(depth.camera), optics=known.optics, markers=known.markers)
    image = optics.render(lit, np.nan_to_num(depth.indentation_mm), seed=None)
    return TactileFrame(
        sensor=source.name, image=image, reference=render_reference(lit), camera=depth.camera
    )


def build_condition(
    frame: TactileFrame, source: SensorSpec, alignment: Alignment, target: SensorSpec
) -> Floats:
    """(channels, rows, cols) on the working grid; see `image_condition.build_image_condition`."""
    camera = source.camera if frame.camera is None else frame.camera
    reference: Any = frame.reference
    if reference is None:
        reference = render_reference(source.with_camera(camera))
    if reference.shape != frame.image.shape:
        raise ShapeError(
            f"the reference image must have the shape {frame.image.shape}, got {reference.shape}"
        )
    change = source.sensor_kind.compute_change(frame.image, reference)
    return build_image_condition(change, camera, source, make_working_sensor(target), alignment)
