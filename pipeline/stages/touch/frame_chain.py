"""What methods from image to image read of depth and target depth: whether there is a touch to
generate.

Such methods generate from the source's image, but they are trained on touches: of a change that is
no touch they make one. So nothing is sampled where the source's depth has no contact, or where the
touch misses the target.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeVar, TypeVarTuple, Unpack, cast

from pipeline.calibration.calibration_table import Calibration
from pipeline.core.errors import select_warnings
from pipeline.core.graph import Fallback, Method, Skipped
from pipeline.core.progress import SILENT, Progress
from pipeline.core.values.frames import TactileFrame
from pipeline.core.values.results import DepthMap, GeneratedTouch, TargetDepth
from pipeline.sensors.alignment import Alignment
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.cloud.stage import BACK_PROJECTION
from pipeline.stages.depth.frame_checks import check_frame
from pipeline.stages.depth.stage import NETWORK
from pipeline.stages.depth.stage import PHYSICS as DEPTH_BY_PHYSICS
from pipeline.stages.target_depth.stage import SURFACE
from pipeline.stages.touch import physical_render

READS = ("frame", "depth", "source", "calibration", "alignment", "target", "target_depth")
DEFAULTS = (NETWORK, DEPTH_BY_PHYSICS, BACK_PROJECTION, SURFACE)  # of a route from touch to touch
_Answer = GeneratedTouch | Skipped[GeneratedTouch] | Fallback[GeneratedTouch]
Params = TypeVar("Params")
Reads = TypeVarTuple("Reads")


def guard_contact(
    run: Callable[[TactileFrame, DepthMap, Unpack[Reads], Params, Progress], _Answer],
) -> Callable[[TactileFrame, DepthMap, Unpack[Reads], Params, Progress], _Answer]:
    """Return a function (*READS, weights, params, progress) that asks `run` only where there is
    contact.

    `run` takes the same; its target depth begins with the warnings of the depth.
    """

    def run_in_contact(
        frame: TactileFrame, depth: DepthMap, *args: *tuple[*Reads, Params, Progress]
    ) -> _Answer:
        values: Any = args  # by position, as the graph passes them
        source, _, _, target, view, *_ = values
        check_frame(frame, source)
        view = replace(view, notes=(*select_warnings(depth.notes), *view.notes))
        reference_touch = physical_render.skip_without_contact(view, target)
        if reference_touch is not None:
            return Skipped(output=reference_touch, reason=reference_touch.notes[0])
        ask: Callable[..., _Answer] = cast("Any", run)
        return ask(frame, depth, *values[:4], view, *values[5:])

    return run_in_contact


def render_view(
    view: TargetDepth,
    target: SensorSpec,
    params: physical_render.PhysicalRenderParams,
    progress: Progress = SILENT,
) -> GeneratedTouch:
    """The physical render of a target depth, with the warnings that led to it."""
    touch = physical_render.render_touch(view, target, params, progress)
    return replace(touch, notes=(*select_warnings(view.notes), *touch.notes))


def _render_target_depth(
    _frame: TactileFrame,
    _depth: DepthMap,
    _source: SensorSpec,
    _calibration: Calibration | None,
    _alignment: Alignment,
    target: SensorSpec,
    view: TargetDepth,
    params: physical_render.PhysicalRenderParams,
    progress: Progress = SILENT,
) -> GeneratedTouch:
    return render_view(view, target, params, progress)


RENDER = Method(
    stage="touch",
    name="render",
    title="Physical render",
    help="of the target depth, where a method from image to image does not answer",
    run=_render_target_depth,
    params=physical_render.PhysicalRenderParams,
    reads=READS,
)
