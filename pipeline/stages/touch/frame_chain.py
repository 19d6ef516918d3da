"""What methods from image to image read of depth and target depth: whether there is a touch to
generate.

Such methods generate from the source's image, but they are trained on touches: of a change that is
no touch they make one. So nothing is sampled where the source's depth has no contact, or where the
touch misses the target.

Touches of methods that generate images only: made of the change of a frame, and checked
against the source.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeVar, TypeVarTuple, Unpack, cast

import numpy as np

from pipeline.calibration.calibration_table import Calibration
from pipeline.core.arrays import Floats, freeze
from pipeline.core.errors import StageWarning, select_warnings
from pipeline.core.geometry import rigid
from pipeline.core.graph import Fallback, Method, Skipped
from pipeline.core.progress import SILENT, Progress
from pipeline.core.values.frames import TactileFrame
from pipeline.core.values.results import DepthMap, GeneratedTouch, TargetDepth
from pipeline.physics.sensor_images import render_reference
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


def make_touch_from_change(
    target: SensorSpec, change: Floats, notes: tuple[str, ...] = ()
) -> GeneratedTouch:
    """Touch of a change (rows, cols, channels): a gel's in shares of full brightness, a bubble's
    imprint in mm.

    The change is added to the reference image of the described sensor; source pixels are unknown.
    """
    shape = target.camera.shape
    kind = target.sensor_kind
    scaled = np.float32(kind.full_change) * (change[..., 0] if kind.is_depth else change)
    image = kind.apply_change(render_reference(target), scaled)
    return GeneratedTouch(
        image=freeze(image),
        camera=target.camera,
        source_index=freeze(np.full(shape, -1, np.int32)),
        in_view=freeze(np.ones(shape, np.bool_)),
        notes=notes,
    )


_STRIDE = 8  # px of the source; only its view is needed
_SLACK_MM = 1.0
_MIN_SHARE = 0.05  # share of the view that has to be deeper


def check_depth_limit(
    touch: GeneratedTouch, source: SensorSpec, target: SensorSpec, alignment: Alignment
) -> tuple[StageWarning, ...]:
    """A warning where a bubble's touch is deeper than the source can be pressed.

    Never for a gel's image.

    The contact lies no nearer to the source's camera than its membrane can be indented; the
    alignment gives the same limit for the target. A network trained on another alignment generates
    depths of that alignment.
    """
    if not target.sensor_kind.is_depth:
        return ()
    nearest = np.array(source.rest_depth_mm, np.float64) - source.limits.indentation_max_mm
    points = source.camera.back_project(nearest)[::_STRIDE, ::_STRIDE].reshape(-1, 3)
    x_mm, y_mm, z_mm = rigid.apply(alignment.target_from_source, points).T
    camera = target.camera
    ahead = z_mm > 0
    col = np.zeros(z_mm.shape, np.int64)
    row = np.zeros(z_mm.shape, np.int64)
    col[ahead] = np.rint(camera.fx_px * x_mm[ahead] / z_mm[ahead] + camera.cx_px)
    row[ahead] = np.rint(camera.fy_px * y_mm[ahead] / z_mm[ahead] + camera.cy_px)
    in_image = ahead & (row >= 0) & (row < camera.rows) & (col >= 0) & (col < camera.cols)
    if not in_image.any():
        return ()
    excess_mm = z_mm[in_image] - touch.image[row[in_image], col[in_image]]
    if (excess_mm > _SLACK_MM).mean() <= _MIN_SHARE:
        return ()
    return (
        StageWarning(
            f"the touch is {float(excess_mm.max()):.1f} mm deeper than the source can be pressed: "
            "the network was "
            "trained on another alignment of the sensors; use physics or T2D2"
        ),
    )
