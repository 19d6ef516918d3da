"""The stage *touch*: what the target sensor would have recorded."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from pipeline.core.geometry.meshes import Mesh
from pipeline.core.graph import Fallback, Method, Skipped, skip_if_exact
from pipeline.core.params import NoParams
from pipeline.core.progress import SILENT, Progress
from pipeline.core.values.results import (
    DepthMap,
    GeneratedTouch,
    ObjectPose,
    SealedMembrane,
    TargetDepth,
)
from pipeline.sensors.alignment import Alignment
from pipeline.sensors.spec import SensorSpec
from pipeline.stages import ground_truth
from pipeline.stages.metrics.stage_metrics import compute_image_metrics
from pipeline.stages.networks.network_factory import fall_back_without_weights
from pipeline.stages.networks.onnx_predictor import ResidualNetwork
from pipeline.stages.stage import GroundTruth, Stage
from pipeline.stages.touch import latent_diffusion, object_touch, physical_render, t2d2, t2t, vqvae
from pipeline.stages.touch.frame_chain import DEFAULTS, READS, RENDER, guard_contact
from pipeline.stages.touch.latent_diffusion import LatentParams
from pipeline.stages.touch.residual_diffusion import DiffusionParams, make_draft_params
from pipeline.stages.touch.t2d2 import T2D2Params

if TYPE_CHECKING:
    from torch import nn

_VIEW = ("target_depth", "target")


def _render(
    view: TargetDepth,
    target: SensorSpec,
    start: SealedMembrane | None,
    params: physical_render.PhysicalRenderParams,
    progress: Progress = SILENT,
) -> GeneratedTouch:
    return physical_render.render_touch(view, target, params, progress, start=start)


def _generate_by_t2d2(
    view: TargetDepth,
    target: SensorSpec,
    start: SealedMembrane | None,
    network: ResidualNetwork,
    params: T2D2Params,
    progress: Progress = SILENT,
) -> GeneratedTouch | Fallback[GeneratedTouch]:
    return t2d2.generate_touch(view, target, network, params, progress, start=start)


def _generate_by_latent_t2d2(
    view: TargetDepth,
    target: SensorSpec,
    _start: SealedMembrane | None,
    network: nn.Module,
    params: LatentParams,
    progress: Progress = SILENT,
) -> GeneratedTouch:
    return latent_diffusion.generate_touch_from_depth(view, target, network, params, progress)


PHYSICS = Method(
    stage="touch",
    name="physics",
    title="Physical render",
    help="simulation of the target's gel or membrane and its optics",
    run=skip_if_exact(physical_render.skip_without_contact, _render),
    params=physical_render.PhysicalRenderParams,
    reads=(*_VIEW, "previous_membrane"),
    version=6,
)
T2D2 = Method(
    stage="touch",
    name="t2d2",
    title="T2D2 diffusion",
    help="physical render plus a residual from a network trained on the target sensor",
    run=skip_if_exact(
        physical_render.skip_without_contact,
        fall_back_without_weights(_generate_by_t2d2, fallback=PHYSICS),
    ),
    params=T2D2Params,
    reads=(*PHYSICS.reads, "touch_weights"),
    weights=t2d2.select_weights,
    draft=make_draft_params,
    version=9,
)


def _press_object_or_fall_back(
    view: TargetDepth,
    target: SensorSpec,
    depth: DepthMap,
    source: SensorSpec,
    alignment: Alignment,
    mesh: Mesh | None,
    previous: ObjectPose | None,
    params: object_touch.ObjectParams,
    progress: Progress = SILENT,
) -> GeneratedTouch | Skipped[GeneratedTouch] | Fallback[GeneratedTouch]:
    """The object's touch; T2D2's, with the reason, where no pose of the object explains the
    source.
    """
    touch = object_touch.press_object(
        depth, source, alignment, target, mesh, previous, params, progress
    )
    if isinstance(touch, GeneratedTouch):
        return replace(touch, source_index=physical_render.trace_source_pixels(view))
    by_t2d2: Callable[..., Any] = T2D2.run
    answer = by_t2d2(
        view, target, None, t2d2.select_weights(target, target, None), T2D2.params(), progress
    )
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
    reads=(*_VIEW, "depth", "source", "alignment", "mesh", "previous"),
    version=3,
)
T2T = Method(
    stage="touch",
    name="t2t",
    title="T2T diffusion",
    help="image-to-image diffusion trained on pairs of a gel and a bubble",
    run=guard_contact(fall_back_without_weights(t2t.generate_touch, fallback=RENDER)),
    params=DiffusionParams,
    reads=(*READS, "touch_weights"),
    defaults=DEFAULTS,
    weights=t2t.select_weights,
    draft=make_draft_params,
    version=11,
)
LATENT_T2D2 = Method(
    stage="touch",
    name="latent_t2d2",
    title="T2D2 latent diffusion (the paper's)",
    help="200 steps from noise, conditioned on the target depth and its mask",
    run=skip_if_exact(
        physical_render.skip_without_contact,
        fall_back_without_weights(_generate_by_latent_t2d2, fallback=PHYSICS),
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
    run=guard_contact(fall_back_without_weights(latent_diffusion.generate_touch, fallback=RENDER)),
    params=LatentParams,
    reads=(*READS, "touch_weights"),
    defaults=DEFAULTS,
    weights=latent_diffusion.select_weights,
    draft=latent_diffusion.make_draft_params,
    version=2,
)
VQVAE = Method(
    stage="touch",
    name="vqvae",
    title="VQ-VAE, the paper's baseline",
    help="image-to-image at 128 x 128 through a codebook; uses no depth",
    run=guard_contact(fall_back_without_weights(vqvae.generate_touch, fallback=RENDER)),
    params=NoParams,
    reads=(*READS, "touch_weights"),
    defaults=DEFAULTS,
    weights=vqvae.select_weights,
    version=2,
)


def _compute_metrics(touch: GeneratedTouch, facts: GroundTruth) -> Mapping[str, float]:
    return (
        {}
        if facts.target_observation is None
        else compute_image_metrics(touch.image, facts.target_observation)
    )


STAGE = Stage(
    name="touch",
    title="Generated touch",
    sensor_role="target",
    methods=(PHYSICS, T2D2, LATENT_T2D2, T2T, LATENT, VQVAE, OBJECT),
    value_type=GeneratedTouch,
    compute_metrics=_compute_metrics,
    make_ground_truth=ground_truth.build_touch,
    has_steps=True,
)
