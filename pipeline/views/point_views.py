"""How values are shown that are points: the cloud, and the object's pose with the steps of its
registration.
"""

import math
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from pipeline.core.arrays import Doubles, Floats, Image, Indices, Mask, freeze
from pipeline.core.geometry import rigid
from pipeline.core.geometry.camera import Camera
from pipeline.core.geometry.distance_grid import DistanceGrid, load_distance_grid
from pipeline.core.values.results import Cloud, DepthMap, ObjectPose, PoseStep
from pipeline.views.colours import (
    NO_VALUE_COLOUR,
    REGISTERED_POINT_COLOUR,
    UNMATCHED_POINT_COLOUR,
    ColourScale,
    apply_colour_map,
    repeat_colour,
)
from pipeline.views.display_params import DisplayParams
from pipeline.views.layers import (
    Layer,
    make_cloud_layer,
    make_lines_layer,
    make_membrane_layer,
    make_object_layer,
    stretch_depth,
)
from pipeline.views.preview import (
    PixelPositions,
    Preview,
    compute_pixel_mm,
    make_deviation_scale,
    trace_outline,
)
from pipeline.views.view import (
    PreviewContext,
    ProbePoint,
    StepCurve,
    StepHistory,
    View,
    look_up_element,
    to_xyz,
)

_REACH_LABEL = "beyond the resting membrane, + toward camera"
_PREVIEW_SCALE = 0.5  # of the target's resolution, so that neighbouring points leave no holes
_MAX_LINES = 400  # lines from registered points to the object; more would hide it


def _draw_cloud(cloud: Cloud, context: PreviewContext) -> Preview:
    """Cloud seen by the target's camera, coloured by how far points reach past its rest surface."""
    target = context.target
    camera = target.camera.scale(_PREVIEW_SCALE)
    index = _splat(cloud, camera)
    drawn = index >= 0
    reach = np.full(camera.shape, np.nan, dtype=np.float32)
    positions = np.full((*camera.shape, 3), np.nan, dtype=np.float32)
    if len(cloud.points_mm):
        positions[drawn] = cloud.points_mm[index[drawn]]
        reach[drawn] = -target.membrane.signed_distance_mm(cloud.points_mm[index[drawn]])
    scale = make_deviation_scale(context.target, context.display, _REACH_LABEL)
    return Preview(
        pixels=apply_colour_map(reach, scale),
        values=freeze(reach),
        scale=scale,
        frame_name=f"{target.title} frame",
        positions_mm=freeze(positions),
        element_index=index,
        camera=camera,
        pixel_mm=compute_pixel_mm(camera, target),
        caption=f"{len(cloud.points_mm)} points; {_REACH_LABEL}",
    )


def _layer_cloud(cloud: Cloud, context: PreviewContext, _preview: Preview) -> tuple[Layer, ...]:
    """The points over the faint rest surface."""
    times = context.display.get_depth_stretch(context.target)
    points = stretch_depth(cloud.points_mm, context.target, times)
    reach = -context.target.membrane.signed_distance_mm(cloud.points_mm).astype(np.float32)
    scale = make_deviation_scale(context.target, context.display, _REACH_LABEL)
    colours = apply_colour_map(reach, scale)
    layer = make_cloud_layer("cloud", points.astype(np.float32), colours, 3.0, scale)
    return (layer, make_membrane_layer(context.target))


def _trace_cloud(cloud: Cloud, before: ProbePoint) -> ProbePoint:
    point = look_up_element(cloud.source_index, before.index)
    if point < 0:
        why = "skipped by the stride" if cloud.stride > 1 else "not in the cloud"
        return ProbePoint(stage="cloud", text=why)
    x, y, z = to_xyz(cloud.points_mm[point])
    return ProbePoint(
        stage="cloud", index=point, point_mm=(x, y, z), text=f"({x:.2f}, {y:.2f}, {z:.2f}) mm"
    )


def _splat(cloud: Cloud, camera: Camera) -> Indices:
    index = np.full(camera.shape, -1, dtype=np.int32)
    if len(cloud.points_mm):
        x_px, y_px, visible = camera.project(cloud.points_mm)
        rows = np.rint(y_px[visible]).astype(np.intp)
        cols = np.rint(x_px[visible]).astype(np.intp)
        which = np.flatnonzero(visible)
        # the nearest wins its pixel
        nearest_last = np.argsort(-cloud.points_mm[which, 2], kind="stable")
        index[rows[nearest_last], cols[nearest_last]] = which[nearest_last]
    return freeze(index)


CLOUD = View(
    legend="points, target at rest",
    make_preview=_draw_cloud,
    make_layers=_layer_cloud,
    trace_point=_trace_cloud,
)


class Correspondences(NamedTuple):
    """Nearest points on the object of the registered points (n, 3) at one step."""

    nearest_mm: Doubles  # (n, 3) nearest points on the object, in the sensor's frame
    distance_mm: Doubles  # (n,) signed, + outside the object
    is_inlier: Mask  # (n,) within the search distance


def compute_correspondences(pose: ObjectPose, grid: DistanceGrid) -> Correspondences:
    """Nearest points on the object of a pose's registered points.

    `grid` holds the object's signed distances.
    """
    assert pose.sensor_from_object is not None
    in_object = rigid.apply(rigid.invert(pose.sensor_from_object), pose.scene_mm)
    distance_mm, gradients = grid.at(in_object)
    size = np.linalg.norm(gradients, axis=1, keepdims=True)
    foot = in_object - distance_mm[:, None] * gradients / np.maximum(size, 1e-12)
    inliers = np.abs(distance_mm) <= (pose.steps[0].max_correspondence_mm if pose.steps else np.inf)
    return Correspondences(rigid.apply(pose.sensor_from_object, foot), distance_mm, inliers)


def split_steps(pose: ObjectPose) -> tuple[ObjectPose, ...]:
    """The pose at each kept step, with that step only."""
    return tuple(
        replace(
            pose,
            sensor_from_object=step.sensor_from_object,
            rmse_mm=step.rmse_mm,
            fitness=step.fitness,
            steps=(step,),
        )
        for step in pose.steps
    )


def summarise_steps(pose: ObjectPose) -> StepHistory | None:
    """Curves of rms, inlier share and motion per step, and why the registration stopped."""
    if not pose.steps:
        return None
    steps = pose.steps
    motion_mm = (0.0, *(_measure_motion_mm(a, b, pose.scene_mm) for a, b in pairwise(steps)))
    start = (
        f"from one of {pose.starts_tried} starts"
        if pose.starts_tried
        else "from the pose of the previous touch"
    )
    words = tuple(
        f"rms {s.rmse_mm:.3g} mm, {100 * s.fitness:.0f} % of the points with a correspondence"
        + ("" if s.max_correspondence_mm == np.inf else f" within {s.max_correspondence_mm:g} mm")
        + f", moved by {motion:.2g} mm"
        for s, motion in zip(steps, motion_mm, strict=True)
    )
    return StepHistory(
        curves=(
            StepCurve(name="rms", unit="mm", values=tuple(s.rmse_mm for s in steps)),
            StepCurve(
                name="with a correspondence", unit="%", values=tuple(100 * s.fitness for s in steps)
            ),
            StepCurve(name="motion", unit="mm", values=motion_mm),
        ),
        stop_reason=f"{start} in {len(steps) - 1} steps; {pose.stop_reason}",
        descriptions=words,
        phase_starts=tuple(
            k
            for k in range(1, len(steps))
            if steps[k].max_correspondence_mm != steps[k - 1].max_correspondence_mm
        ),
    )


def _measure_motion_mm(a: PoseStep, b: PoseStep, points_mm: Floats) -> float:
    """Rms displacement of the registered points between two steps."""
    motion = b.sensor_from_object @ rigid.invert(a.sensor_from_object)
    displacement = rigid.apply(motion, points_mm) - points_mm
    return float(np.sqrt((displacement**2).sum(axis=1).mean())) if len(displacement) else 0.0


def _draw_pose(pose: ObjectPose, context: PreviewContext) -> Preview:
    """Distance of the registered points to the posed object, over the faded tactile image."""
    depth: DepthMap = context.outputs["touch_depth"]
    values = np.full(depth.camera.shape, np.nan, dtype=np.float32)
    element = np.full(depth.camera.shape, -1, dtype=np.int32)
    at = np.flatnonzero(pose.source_index >= 0)
    scale = make_residual_scale(context.display)
    pixels = _make_faded_background(context, depth)
    caption = f"no pose: {pose.notes[0]}" if pose.notes else "no pose"
    element.flat[pose.source_index[at]] = at
    if pose.sensor_from_object is not None and context.mesh is not None and at.size:
        in_object = rigid.apply(rigid.invert(pose.sensor_from_object), pose.scene_mm[at])
        values.flat[pose.source_index[at]] = load_distance_grid(context.mesh).at(in_object)[0]
        shown = _dilate_points(values, len(pose.scene_mm), depth.contact)
        pixels = np.where(np.isfinite(shown)[..., None], apply_colour_map(shown, scale), pixels)
        share = f"{100 * pose.fitness:.0f} % of {at.size} points"
        caption = f"distance to object, + outside; rms {pose.rmse_mm:.2f} mm, {share}"
    return Preview(
        pixels=freeze(np.ascontiguousarray(pixels, dtype=np.uint8)),
        values=freeze(values),
        scale=scale,
        frame_name=f"{context.target.title} frame",
        positions_mm=PixelPositions(depth.camera, depth.depth_mm),
        outline_px=trace_outline(depth.contact),
        pixel_mm=compute_pixel_mm(depth.camera, context.target),
        caption=caption,
        element_index=freeze(element),
        camera=depth.camera,
    )


def make_residual_scale(display: DisplayParams) -> ColourScale:
    """Colour scale of the distance to the posed object."""
    limit = display.residual_limit_mm
    setting = "residual_limit_mm"
    return ColourScale(
        colour_map="diverging",
        low=-limit,
        high=limit,
        unit="mm",
        quantity="distance to object, + outside it",
        low_setting=setting,
        high_setting=setting,
        is_subtractable=False,
    )


def _layer_pose(pose: ObjectPose, context: PreviewContext, _preview: Preview) -> tuple[Layer, ...]:
    """Registered points, posed object and rest surface."""
    scene = make_cloud_layer(
        "scene", pose.scene_mm, repeat_colour(REGISTERED_POINT_COLOUR, len(pose.scene_mm)), 4.0
    )
    layers = (scene, make_membrane_layer(context.target))
    if context.mesh is None or pose.sensor_from_object is None:
        return layers
    return (*layers, make_object_layer(context.mesh, pose.sensor_from_object))


def _layer_step(pose: ObjectPose, context: PreviewContext, preview: Preview) -> tuple[Layer, ...]:
    """The object at one step, with a line from each registered point to its nearest surface
    point.
    """
    if context.mesh is None or pose.sensor_from_object is None:
        return _layer_pose(pose, context, preview)
    nearest_mm, distance_mm, is_inlier = compute_correspondences(
        pose, load_distance_grid(context.mesh)
    )
    scale = make_residual_scale(context.display)
    mapped = apply_colour_map(distance_mm.astype(np.float32), scale)
    colours = np.where(is_inlier[:, None], mapped, UNMATCHED_POINT_COLOUR).astype(np.uint8)
    every = slice(None, None, max(1, math.ceil(len(colours) / _MAX_LINES)))
    ends = np.stack([pose.scene_mm, nearest_mm.astype(np.float32)], axis=1)
    return (
        make_cloud_layer("scene", pose.scene_mm, colours, 4.0, scale),
        make_lines_layer("correspondences", ends[every], colours[every], scale),
        *_layer_pose(pose, context, preview)[1:],
    )


def _trace_pose(pose: ObjectPose, before: ProbePoint) -> ProbePoint:
    point = look_up_element(pose.source_index, before.index)
    here = replace(before, stage="pose", index=-1, point_mm=None)
    if point < 0:
        return replace(here, text="not among the registered points")
    x, y, z = to_xyz(pose.scene_mm[point])
    text = f"registered at ({x:.2f}, {y:.2f}, {z:.2f}) mm"
    return replace(here, index=point, point_mm=(x, y, z), text=text)


def _make_faded_background(context: PreviewContext, touch_depth: DepthMap) -> Image:
    touch = context.outputs.get("touch")
    if touch is None or touch.image.ndim == 2:
        return np.full((*touch_depth.camera.shape, 3), NO_VALUE_COLOUR, dtype=np.uint8)
    grey = touch.image.mean(axis=-1, keepdims=True)
    return np.broadcast_to(150.0 + 0.4 * grey, touch.image.shape).astype(np.uint8)


def _dilate_points(values: Floats, n_points: int, contact: Mask) -> Floats:
    """Points dilated to the area they stand for, so that sparse points are visible."""
    import cv2

    side = max(
        3, min(9, 2 * round(0.5 * math.sqrt(max(1, int(contact.sum())) / max(1, n_points))) + 1)
    )
    kernel = np.ones((side, side), dtype=np.uint8)
    high = cv2.dilate(np.where(np.isfinite(values), values, -1e3).astype(np.float32), kernel)
    return np.where(high > -1e2, high, np.nan).astype(np.float32)


POSE = View(
    legend="registered points, object, target at rest",
    make_preview=_draw_pose,
    make_layers=_layer_pose,
    trace_point=_trace_pose,
    preview_stages=("touch", "touch_depth"),
    exaggerates_indentation=False,
    split_steps=split_steps,
    make_step_layers=_layer_step,
    summarise_steps=summarise_steps,
)
