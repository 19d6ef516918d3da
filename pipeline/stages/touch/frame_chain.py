"""The chain from a frame to the target depth inside methods that read the frame, with default methods and parameters.

Methods from image to image read no depth, but they are trained on touches: of a change that is no touch they make one.
The chain answers first, so that nothing is sampled where nothing touches or where the touch misses the target.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeVar, TypeVarTuple, Unpack

from pipeline.base.errors import AlignmentWarning, select_warnings
from pipeline.base.memo import Memo
from pipeline.base.progress import SILENT, Progress, SubProgress
from pipeline.calibration.calibration_table import Calibration
from pipeline.engine.digests import compute_cached_digest
from pipeline.engine.graph import Fallback, Method, Skipped
from pipeline.networks import network_factory
from pipeline.networks.weights import NoWeights, Weights
from pipeline.sensors.alignment import Alignment
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.cloud import back_projection
from pipeline.stages.depth import bubble_network, photometric
from pipeline.stages.depth.frame_checks import check_frame
from pipeline.stages.target_depth import surface_projection
from pipeline.stages.touch import physical_render
from pipeline.values.frames import TactileFrame
from pipeline.values.results import DepthMap, GeneratedTouch, TargetDepth

READS = ("frame", "source", "calibration", "alignment", "target")
_Answer = GeneratedTouch | Skipped[GeneratedTouch] | Fallback[GeneratedTouch]
Params = TypeVar("Params")
Reads = TypeVarTuple("Reads")


def list_inner_methods(kind: str) -> dict[str, str]:
    """Return stage -> method of `project_frame` for a source of this kind."""
    depth = "network" if kind in bubble_network.KINDS else "physics"
    return {"depth": depth, "cloud": "back_projection", "target_depth": "surface"}


def project_frame(
    frame: TactileFrame,
    source: SensorSpec,
    calibration: Calibration | None,
    alignment: Alignment,
    target: SensorSpec,
    progress: Progress = SILENT,
) -> tuple[DepthMap, TargetDepth]:
    """Depth of a frame and its target depth, cached; the notes of the second begin with the warnings of the first."""
    is_network = list_inner_methods(source.kind)["depth"] == "network"
    weights = bubble_network.select_weights(source, source, None) if is_network else NoWeights(why="")

    def project() -> tuple[DepthMap, TargetDepth]:
        depth = _estimate_depth(frame, source, calibration, weights, progress)
        cloud = back_projection.back_project_depth(depth, alignment, back_projection.BackProjectionParams())
        params = surface_projection.SurfaceProjectionParams()
        view = surface_projection.skip_without_contact(cloud, target, params)
        view = view or surface_projection.project_cloud(cloud, target, params)
        return depth, replace(view, notes=(*select_warnings(depth.notes), *view.notes))

    return _projected.get_or_make(
        compute_cached_digest((frame, source, calibration, alignment, target, weights)), project
    )


_projected: Memo[str, tuple[DepthMap, TargetDepth]] = Memo(4)


def guard_contact(
    run: Callable[[Unpack[Reads], Params, Progress], _Answer],
) -> Callable[[Unpack[Reads], Params, Progress], _Answer]:
    """Return a method's function that asks `run` (*READS, weights, params, progress) only where there is contact.

    Weights of recorded pairs know how their sensors lay to each other: for them the alignment rules nothing out.
    """

    def run_in_contact(*args: *tuple[*Reads, Params, Progress]) -> _Answer:
        values: Any = args  # by position, as the graph passes them
        frame, source, calibration, alignment, target, weights, _, progress = values
        check_frame(frame, source)
        reads = frame, source, calibration, alignment, target
        depth, view = project_frame(*reads, progress)
        reference_touch = physical_render.skip_without_contact(view, target)
        if reference_touch is not None and not depth.contact.any():
            return Skipped(output=reference_touch, reason=reference_touch.notes[0])
        knows_alignment = isinstance(weights, Weights) and bool(weights.config.get("trained_on_recordings"))
        if reference_touch is not None and not knows_alignment:
            why = next(
                (n for n in view.notes if isinstance(n, AlignmentWarning)), "the touch does not reach the target"
            )
            touch = replace(reference_touch, notes=(*select_warnings(view.notes), *reference_touch.notes))
            return Fallback(result=touch, reason=f"physics: {why}")
        return run(*args)

    return run_in_contact


def render_from_frame(
    frame: TactileFrame,
    source: SensorSpec,
    calibration: Calibration | None,
    alignment: Alignment,
    target: SensorSpec,
    params: physical_render.PhysicalRenderParams,
    progress: Progress = SILENT,
) -> GeneratedTouch:
    """The touch by depth, cloud, target depth and physical render."""
    _, view = project_frame(frame, source, calibration, alignment, target, SubProgress(progress, 0.0, 0.6))
    return render_view(view, target, params, SubProgress(progress, 0.6, 0.4))


def render_view(
    view: TargetDepth, target: SensorSpec, params: physical_render.PhysicalRenderParams, progress: Progress = SILENT
) -> GeneratedTouch:
    """The physical render of a projected frame, with the warnings that led to it; cached."""

    def render() -> GeneratedTouch:
        touch = physical_render.render_touch(view, target, params, progress)
        return replace(touch, notes=(*select_warnings(view.notes), *touch.notes))

    return _rendered.get_or_make(compute_cached_digest((view, target, params)), render)


_rendered: Memo[str, GeneratedTouch] = Memo(4)


def _estimate_depth(
    frame: TactileFrame,
    source: SensorSpec,
    calibration: Calibration | None,
    weights: Weights | NoWeights,
    progress: Progress,
) -> DepthMap:
    if isinstance(weights, NoWeights):
        return photometric.estimate_depth(frame, source, calibration, photometric.DepthParams(), progress)
    params = bubble_network.NetworkParams()
    at_rest = photometric.skip_without_contact(frame, source, calibration, params)
    return at_rest or bubble_network.estimate_frame(
        frame, source, calibration, network_factory.load_predictor(weights), params, progress
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
