"""The stage *cloud*: contact points in the target's frame."""

import numpy as np

from pipeline.base.arrays import Indices, freeze
from pipeline.engine.graph import Method, skip_if_exact
from pipeline.geometry.camera import Camera
from pipeline.previews.colours import apply_colour_map
from pipeline.previews.layers import Layer, make_cloud_layer, make_membrane_layer, stretch_depth
from pipeline.previews.preview import PointPositions, Preview, compute_pixel_mm, make_deviation_scale
from pipeline.stages.cloud import back_projection
from pipeline.stages.stage import PreviewContext, ProbePoint, Stage, look_up_element, to_xyz
from pipeline.values.results import Cloud

_REACH_LABEL = "past rest surface, + toward camera"
PREVIEW_SCALE = 0.5  # of the target's resolution, so that neighbouring points leave no holes

BACK_PROJECTION = Method(
    stage="cloud",
    name="back_projection",
    title="Back-projection",
    help="every contact pixel as a point (paper, eq. P_T)",
    run=skip_if_exact(back_projection.skip_without_contact, back_projection.back_project_depth),
    params=back_projection.BackProjectionParams,
    reads=("depth", "alignment"),
    version=3,
)


def _make_preview(cloud: Cloud, context: PreviewContext) -> Preview:
    """Cloud seen by the target's camera, coloured by how far points reach past its rest surface."""
    target = context.target
    camera = target.camera.scale(PREVIEW_SCALE)
    index = _splat(cloud, camera)
    drawn = index >= 0
    reach = np.full(camera.shape, np.nan, dtype=np.float32)
    if len(cloud.points_mm):
        reach[drawn] = -target.membrane.signed_distance_mm(cloud.points_mm[index[drawn]])
    scale = make_deviation_scale(context.target, context.display, _REACH_LABEL)
    return Preview(
        pixels=apply_colour_map(reach, scale), values=freeze(reach), scale=scale, frame_name=f"{target.name} frame",
        positions_mm=PointPositions(cloud.points_mm, index), element_index=index, camera=camera,
        pixel_mm=compute_pixel_mm(camera, target),
        caption=f"{len(cloud.points_mm)} points; {_REACH_LABEL}",
    )  # fmt: skip


def _make_layers(cloud: Cloud, context: PreviewContext, _preview: Preview) -> tuple[Layer, ...]:
    """The points over the faint rest surface."""
    points = stretch_depth(cloud.points_mm, context.target, context.display.get_depth_stretch(context.target))
    reach = -context.target.membrane.signed_distance_mm(cloud.points_mm).astype(np.float32)
    scale = make_deviation_scale(context.target, context.display, _REACH_LABEL)
    colours = apply_colour_map(reach, scale)
    layer = make_cloud_layer("cloud", points.astype(np.float32), colours, 3.0, scale.colour_map)
    return (layer, make_membrane_layer(context.target))


def _trace_point(cloud: Cloud, before: ProbePoint) -> ProbePoint:
    point = look_up_element(cloud.source_index, before.index)
    if point < 0:
        why = "skipped by the stride" if cloud.stride > 1 else "not in the cloud"
        return ProbePoint(stage="cloud", index=-1, text=why)
    x, y, z = to_xyz(cloud.points_mm[point])
    return ProbePoint(stage="cloud", index=point, point_mm=(x, y, z), text=f"({x:.2f}, {y:.2f}, {z:.2f}) mm")


def _splat(cloud: Cloud, camera: Camera) -> Indices:
    index = np.full(camera.shape, -1, dtype=np.int32)
    if len(cloud.points_mm):
        x_px, y_px, visible = camera.project(cloud.points_mm)
        rows, cols = np.rint(y_px[visible]).astype(np.intp), np.rint(x_px[visible]).astype(np.intp)
        which = np.flatnonzero(visible)
        nearest_last = np.argsort(-cloud.points_mm[which, 2], kind="stable")  # the nearest wins its pixel
        index[rows[nearest_last], cols[nearest_last]] = which[nearest_last]
    return freeze(index)


STAGE = Stage(
    name="cloud",
    title="Cloud",
    legend="points, target at rest",
    sensor_role="target",
    methods=(BACK_PROJECTION,),
    make_preview=_make_preview,
    make_layers=_make_layers,
    trace_point=_trace_point,
)
