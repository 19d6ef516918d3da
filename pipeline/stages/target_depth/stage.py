"""The stage *target_depth*: the cloud as depth and contact in the target's image."""

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
    help="triangles between neighbouring source pixels, rasterised with a z-buffer",
    run=skip_if_exact(surface_projection.skip_without_contact, surface_projection.project_cloud),
    params=surface_projection.SurfaceProjectionParams,
    reads=("cloud", "target"),
    version=4,
)
POINT_SPLAT = Method(
    stage="target_depth",
    name="paper",
    title="Point splat (paper)",
    help="single points, as in the equations (D_T'' and M_T'')",
    run=skip_if_exact(surface_projection.skip_without_contact, surface_projection.project_cloud),
    params=surface_projection.PointSplatParams,
    reads=("cloud", "target"),
)


def make_preview(depth: TargetDepth, context: PreviewContext) -> Preview:
    """Indentation of the target's rest surface wherever there is depth, with the contact outline."""
    shown = freeze(np.asarray(compute_rest_depth_mm(context.target, depth.camera) - depth.depth_mm, dtype=np.float32))
    caption = f"{INDENTATION_LABEL}; mask outlined"
    return make_indentation_preview(
        shown, depth.depth_mm, depth.contact, depth.camera, context.target, context.display, caption
    )


def make_layers(depth: TargetDepth, context: PreviewContext, preview: Preview) -> tuple[Layer, ...]:
    """The surface seen by the target, over its faint rest surface."""
    rest = compute_rest_depth_mm(context.target, depth.camera)
    shown = rest - context.display.get_depth_stretch(context.target) * (rest - depth.depth_mm)
    return (
        make_grid_layer("target_depth", depth.camera.back_project(shown), preview),
        make_membrane_layer(context.target),
    )


def _trace_point(depth: TargetDepth, before: ProbePoint) -> ProbePoint:
    """The target pixel of a cloud point; several points share one where the target is coarser."""
    point = before.point_mm
    if point is None:
        return ProbePoint(stage="target_depth", index=-1, text="not in the cloud")
    x_px, y_px, visible = (a[0] for a in depth.camera.project(np.array([point])))
    if not visible:
        out_x = max(-x_px, x_px - depth.camera.cols + 1, 0.0)
        out_y = max(-y_px, y_px - depth.camera.rows + 1, 0.0)
        return ProbePoint(
            stage="target_depth", index=-1, point_mm=point, text=f"outside the image by {max(out_x, out_y):.0f} px"
        )
    row, col = int(np.floor(y_px + 0.5)), int(np.floor(x_px + 0.5))
    seen_mm = float(depth.depth_mm[row, col])
    index, pixel_text = -1, f"({col}, {row})"
    if not np.isfinite(seen_mm):
        text = f"{pixel_text}, omitted at a depth jump"
    elif point[2] > seen_mm + surface_projection.SAME_SURFACE_MM:
        text = f"{pixel_text}, hidden by a surface {point[2] - seen_mm:.2f} mm nearer"
    else:
        pushed_mm = float(depth.indentation_mm[row, col])
        index = row * depth.camera.cols + col
        text = f"{pixel_text}, " + (
            f"{pushed_mm:.3f} mm in" if depth.contact[row, col] else "does not reach the membrane"
        )
    return ProbePoint(stage="target_depth", index=index, row=row, col=col, point_mm=point, text=text)


STAGE = Stage(
    name="target_depth",
    title="Target depth",
    legend="surface seen by the target",
    sensor_role="target",
    methods=(SURFACE, POINT_SPLAT),
    make_preview=make_preview,
    make_layers=make_layers,
    trace_point=_trace_point,
    make_ground_truth=ground_truth.build_target_depth,
)
