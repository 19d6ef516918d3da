"""The slot *view*: the cloud as the target's camera would see it."""

from __future__ import annotations

import numpy as np

from pipeline.base.arrays import freeze
from pipeline.engine.graph import Method, skip_if_exact
from pipeline.previews.layers import Layer, make_grid_layer, make_membrane_layer
from pipeline.previews.preview import INDENTATION_LABEL, Preview, compute_rest_depth_mm, make_indentation_preview
from pipeline.stages import ground_truth
from pipeline.stages.stage import PreviewContext, ProbePoint, Stage
from pipeline.stages.target_depth import surface_projection
from pipeline.values.results import TargetDepth

SURFACE = Method(
    stage="target_depth",
    name="surface",
    title="Surface",
    help="triangles between neighbouring pixels",
    run=skip_if_exact(surface_projection.skip_without_contact, surface_projection.project_cloud),
    params=surface_projection.SurfaceProjectionParams,
    reads=("cloud", "target"),
    version=4,
)
POINT_SPLAT = Method(
    stage="target_depth",
    name="paper",
    title="Paper",
    help="single points, as in the equations (D_T'' and M_T'')",
    run=skip_if_exact(surface_projection.skip_without_contact, surface_projection.project_cloud),
    params=surface_projection.PointSplatParams,
    reads=("cloud", "target"),
)


def make_preview(view: TargetDepth, seen: PreviewContext) -> Preview:
    """Target depth as indentation where there is a surface, with the mask's outline."""
    shown = freeze(np.asarray(compute_rest_depth_mm(seen.target, view.camera) - view.depth_mm, dtype=np.float32))
    caption = f"{INDENTATION_LABEL}; mask outlined"
    return make_indentation_preview(shown, view.depth_mm, view.contact, view.camera, seen.target, seen.display, caption)


def make_layers(view: TargetDepth, seen: PreviewContext, picture: Preview) -> tuple[Layer, ...]:
    """The surface that the target would see, over its faint rest surface."""
    rest = compute_rest_depth_mm(seen.target, view.camera)
    shown = rest - seen.display.get_depth_stretch(seen.target) * (rest - view.depth_mm)
    return (
        make_grid_layer("target_depth", view.camera.back_project(shown), picture.pixels),
        make_membrane_layer(seen.target),
    )


def _follow(view: TargetDepth, before: ProbePoint) -> ProbePoint:
    """The target pixel that a cloud point falls on: several points may share one where the target is coarser."""
    where = before.point_mm
    if where is None:
        return ProbePoint(stage="target_depth", index=-1, text="not carried over")
    x_px, y_px, visible = (a[0] for a in view.camera.project(np.array([where])))
    if not visible:
        out_x = max(-x_px, x_px - view.camera.cols + 1, 0.0)
        out_y = max(-y_px, y_px - view.camera.rows + 1, 0.0)
        return ProbePoint(
            stage="target_depth", index=-1, point_mm=where, text=f"outside the image by {max(out_x, out_y):.0f} px"
        )
    row, col = int(np.floor(y_px + 0.5)), int(np.floor(x_px + 0.5))
    seen_mm = float(view.depth_mm[row, col])
    index, place = -1, f"({col}, {row})"
    if not np.isfinite(seen_mm):
        text = f"{place}, cut away at a depth jump"
    elif where[2] > seen_mm + surface_projection.SAME_SURFACE_MM:
        text = f"{place}, hidden behind what is {where[2] - seen_mm:.2f} mm nearer"
    else:
        pushed = float(view.indentation_mm[row, col])
        index = row * view.camera.cols + col
        text = f"{place}, " + (f"{pushed:.3f} mm in" if view.contact[row, col] else "does not reach the membrane")
    return ProbePoint(stage="target_depth", index=index, row=row, col=col, point_mm=where, text=text)


STAGE = Stage(
    name="target_depth",
    title="Target view",
    legend="what the target sees",
    sensor_role="target",
    methods=(SURFACE, POINT_SPLAT),
    make_preview=make_preview,
    make_layers=make_layers,
    trace_point=_follow,
    make_ground_truth=ground_truth.build_target_depth,
)
