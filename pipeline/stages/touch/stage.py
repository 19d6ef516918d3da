"""The stage *touch*: what the target sensor would have recorded."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from pipeline.base.arrays import Floats
from pipeline.base.params import NoParams
from pipeline.base.progress import SILENT, Progress
from pipeline.engine.graph import Fallback, Method, Skipped, skip_if_exact
from pipeline.geometry.meshes import Mesh
from pipeline.metrics.stage_metrics import compute_image_metrics
from pipeline.previews.layers import Layer, make_frame_layer, make_surface_layer
from pipeline.previews.preview import Preview, make_frame_preview
from pipeline.sensors.alignment import Alignment
from pipeline.sensors.spec import SensorSpec
from pipeline.stages import ground_truth
from pipeline.stages.network_fallback import fall_back_without_weights
from pipeline.stages.stage import (
    GroundTruth,
    PreviewContext,
    ProbePoint,
    Stage,
    StepCurve,
    StepHistory,
    look_up_element,
)
from pipeline.stages.touch import latent_diffusion, object_touch, physical_render, t2d2, t2t, vqvae
from pipeline.stages.touch.frame_chain import PHYSICS_FROM_FRAME, READS, guard_contact, list_inner_methods
from pipeline.stages.touch.latent_diffusion import LatentParams
from pipeline.stages.touch.residual_diffusion import DiffusionParams, make_draft_params
from pipeline.values.results import DepthMap, GeneratedTouch, ObjectPose, TargetDepth

PHYSICS = Method(
    stage="touch",
    name="physics",
    title="Physical render",
    help="simulation of the target's gel or membrane and its optics",
    run=skip_if_exact(physical_render.skip_without_contact, physical_render.render_touch),
    params=physical_render.PhysicalRenderParams,
    reads=("target_depth", "target"),
    version=5,
)
T2D2 = Method(
    stage="touch",
    name="t2d2",
    title="T2D2 diffusion",
    help="physical render plus a residual from a network trained on the target sensor",
    run=skip_if_exact(
        physical_render.skip_without_contact, fall_back_without_weights(t2d2.generate_touch, fallback=PHYSICS)
    ),
    params=DiffusionParams,
    reads=(*PHYSICS.reads, "touch_weights"),
    weights=t2d2.select_weights,
    draft=make_draft_params,
    version=8,
)


def _press_object_or_fall_back(
    view: TargetDepth, target: SensorSpec, depth: DepthMap, source: SensorSpec, alignment: Alignment, mesh: Mesh | None,
    previous: ObjectPose | None, params: object_touch.ObjectParams, progress: Progress = SILENT,
) -> GeneratedTouch | Skipped[GeneratedTouch] | Fallback[GeneratedTouch]:  # fmt: skip
    """The object's touch; T2D2's, with the reason, where no pose of the object explains the source."""
    touch = object_touch.press_object(depth, source, alignment, target, mesh, previous, params, progress)
    if isinstance(touch, GeneratedTouch):
        return touch
    by_t2d2: Callable[..., Any] = T2D2.run
    answer = by_t2d2(view, target, t2d2.select_weights(target, target, None), T2D2.params(), progress)
    if isinstance(answer, Fallback):
        return Fallback(result=answer.result, reason=f"physics: {touch}")
    return Fallback(result=answer, reason=f"T2D2: {touch}")


OBJECT = Method(
    stage="touch",
    name="object",
    title="Object",
    help="the object's mesh, registered on the source and pressed into the target; needs a mesh",
    run=skip_if_exact(physical_render.skip_without_contact, _press_object_or_fall_back),
    params=object_touch.ObjectParams,
    reads=(*PHYSICS.reads, "depth", "source", "alignment", "mesh", "previous"),
)
T2T = Method(
    stage="touch",
    name="t2t",
    title="T2T diffusion",
    help="image-to-image diffusion trained on pairs; falls back to the physical render where uncertain",
    run=guard_contact(fall_back_without_weights(t2t.generate_touch, fallback=PHYSICS_FROM_FRAME)),
    params=DiffusionParams,
    reads=(*READS, "touch_weights"),
    weights=t2t.select_weights,
    list_inner_methods=list_inner_methods,
    draft=make_draft_params,
    version=10,
)
LATENT_T2D2 = Method(
    stage="touch",
    name="latent_t2d2",
    title="T2D2 latent diffusion (the paper's)",
    help="200 steps from noise, conditioned on the target depth and its mask",
    run=skip_if_exact(
        physical_render.skip_without_contact,
        fall_back_without_weights(latent_diffusion.generate_touch_from_depth, fallback=PHYSICS),
    ),
    params=LatentParams,
    reads=(*PHYSICS.reads, "touch_weights"),
    weights=latent_diffusion.select_t2d2_weights,
    draft=latent_diffusion.make_draft_params,
)
LATENT = Method(
    stage="touch",
    name="latent",
    title="T2T latent diffusion (the paper's)",
    help="200 steps from noise, conditioned on the encoded source image",
    run=guard_contact(fall_back_without_weights(latent_diffusion.generate_touch, fallback=PHYSICS_FROM_FRAME)),
    params=LatentParams,
    reads=(*READS, "touch_weights"),
    weights=latent_diffusion.select_weights,
    list_inner_methods=list_inner_methods,
    draft=latent_diffusion.make_draft_params,
    version=2,
)
VQVAE = Method(
    stage="touch",
    name="vqvae",
    title="VQ-VAE, the paper's baseline",
    help="image-to-image at 128 x 128 through a codebook; uses no depth",
    run=guard_contact(fall_back_without_weights(vqvae.generate_touch, fallback=PHYSICS_FROM_FRAME)),
    params=NoParams,
    reads=(*READS, "touch_weights"),
    weights=vqvae.select_weights,
    list_inner_methods=list_inner_methods,
    version=2,
)


def _make_preview(touch: GeneratedTouch, context: PreviewContext) -> Preview:
    membrane = touch.membrane
    return make_frame_preview(
        touch.image, touch.camera, context.target, context.display,
        depth_mm=None if membrane is None else membrane.depth_mm,
        contact=None if membrane is None else membrane.contact, reference=touch.reference, is_recorded=False,
    )  # fmt: skip


def _make_layers(touch: GeneratedTouch, context: PreviewContext, preview: Preview) -> tuple[Layer, ...]:
    """The target's membrane, textured with the generated image."""
    at = touch.membrane
    if at is None:
        return (make_frame_layer("touch", touch.image, touch.camera, preview, context.target),)
    times = context.display.get_depth_stretch(context.target)
    return (make_surface_layer("touch", at.depth_mm, at.indentation_mm, touch.camera, preview, times),)


def _trace_point(touch: GeneratedTouch, before: ProbePoint) -> ProbePoint:
    index = look_up_element(touch.source_index, before.index)
    if index < 0:
        has_no_contact = touch.membrane is not None and not touch.membrane.contact.any()
        text = "generated without contact" if has_no_contact else "source pixel unknown for this method"
        return ProbePoint(stage="touch", index=-1, text=text)
    row, col = divmod(index, touch.camera.cols)
    if touch.image.ndim == 2:
        text = f"{_describe_displacement(touch, row, col)}{float(touch.image[row, col]):.2f} mm from the camera"
    else:
        text = "generated rgb {} {} {}".format(*(int(v) for v in touch.image[row, col]))
    return ProbePoint(stage="touch", index=index, row=row, col=col, point_mm=before.point_mm, text=text)


def _describe_displacement(touch: GeneratedTouch, row: int, col: int) -> str:
    """Displacement of a bubble's membrane and its direction, where it is known."""
    if touch.membrane is None:
        return ""
    moved_mm = float(touch.membrane.indentation_mm[row, col])
    return f"{abs(moved_mm):.2f} mm {'out' if moved_mm < 0 else 'in'}, "


def _split_steps(touch: GeneratedTouch) -> tuple[GeneratedTouch, ...]:
    return tuple(replace(touch, image=step.image, membrane=step.membrane, steps=()) for step in touch.steps)


def _summarise_steps(touch: GeneratedTouch) -> StepHistory | None:
    """Change per step and distance from the last step, and the step of convergence."""
    if not touch.steps:
        return None
    if np.isnan(touch.steps[0].sigma):
        return _summarise_poses(touch)
    heights = [np.nan_to_num(step.membrane.indentation_mm) for step in touch.steps]
    changes = [heights[0] * 0, *(b - a for a, b in pairwise(heights))]
    last_mm = tuple(_rms_mm(h - heights[-1]) for h in heights)
    span_mm = max(float(np.ptp(heights[-1])), 1e-9)
    settled = next(k for k, h in enumerate(heights) if np.percentile(np.abs(h - heights[-1]), 99.0) <= span_mm / 255)
    return StepHistory(
        curves=(
            StepCurve(name="changed", unit="mm", values=tuple(_rms_mm(o) for o in changes)),
            StepCurve(name="from the last", unit="mm", values=last_mm),
        ),
        stop_reason=f"converged at step {settled + 1} of {len(heights)}: after it 99 % of the pixels "
        "change by less than 1/255 of the indentation range",
        descriptions=tuple(f"noise level {s.sigma:.3g}, {d:.3g} mm (rms) from the last step"
                    for s, d in zip(touch.steps, last_mm, strict=True)),
    )  # fmt: skip


def _summarise_poses(touch: GeneratedTouch) -> StepHistory:
    """Distance of every pose's touch from the best one's."""
    best = touch.steps[-1].membrane.indentation_mm
    off_mm = tuple(_rms_mm(step.membrane.indentation_mm - best) for step in touch.steps)
    return StepHistory(
        curves=(StepCurve(name="from the best pose", unit="mm", values=off_mm),),
        stop_reason=f"{len(off_mm)} poses of the object that explain the source, each pressed into the target",
        descriptions=tuple(f"pose {k + 1}, {mm:.3g} mm (rms) from the best one" for k, mm in enumerate(off_mm)),
    )


def _rms_mm(gap: Floats) -> float:
    return float(np.sqrt((gap.astype(np.float64) ** 2).mean()))


def _compute_metrics(touch: GeneratedTouch, facts: GroundTruth) -> Mapping[str, float]:
    return {} if facts.target_observation is None else compute_image_metrics(touch.image, facts.target_observation)


STAGE = Stage(
    name="touch",
    title="Generated touch",
    legend="target's membrane",
    sensor_role="target",
    methods=(PHYSICS, T2D2, LATENT_T2D2, T2T, LATENT, VQVAE, OBJECT),
    make_preview=_make_preview,
    make_layers=_make_layers,
    trace_point=_trace_point,
    compute_metrics=_compute_metrics,
    make_ground_truth=ground_truth.build_touch,
    has_steps=True,
    split_steps=_split_steps,
    summarise_steps=_summarise_steps,
)
