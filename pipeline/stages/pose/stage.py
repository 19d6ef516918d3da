"""The stage *pose*: the object's pose in the target's frame."""

import math
from collections.abc import Mapping

import numpy as np

from pipeline.base.arrays import Floats, Image, Mask, freeze
from pipeline.engine.graph import Method, skip_if_exact
from pipeline.geometry import rigid
from pipeline.geometry.distance_grid_store import load_distance_grid
from pipeline.metrics.stage_metrics import compute_pose_metrics
from pipeline.previews.colours import (
    NO_VALUE_COLOUR,
    REGISTERED_POINT_COLOUR,
    UNMATCHED_POINT_COLOUR,
    ColourScale,
    apply_colour_map,
    repeat_colour,
)
from pipeline.previews.display_params import DisplayParams
from pipeline.previews.layers import Layer, make_cloud_layer, make_lines_layer, make_membrane_layer, make_object_layer
from pipeline.previews.preview import PixelPositions, Preview, compute_pixel_mm, trace_outline
from pipeline.stages import ground_truth
from pipeline.stages.network_fallback import fall_back_without_weights
from pipeline.stages.pose import network, signed_distances, step_history
from pipeline.stages.stage import GroundTruth, PreviewContext, ProbePoint, Stage, look_up_element, to_xyz
from pipeline.values.results import DepthMap, ObjectPose

_MAX_LINES = 400  # lines from registered points to the object; more would hide it

SIGNED_DISTANCES = Method(
    stage="pose",
    name="signed_distances",
    title="Signed distances",
    help="many starts, registered on the mesh's signed distances, scored by contact and free space",
    run=skip_if_exact(signed_distances.skip_without_contact, signed_distances.estimate_or_track_pose),
    params=signed_distances.PoseParams,
    reads=("touch_depth", "mesh", "previous"),
    version=7,
)
PAPER_2D = Method(
    stage="pose",
    name="paper_2d",
    title="Planar (paper)",
    help="the paper's released evaluation: in-plane rotation and translation of projections",
    run=skip_if_exact(signed_distances.skip_without_contact, signed_distances.estimate_pose_planar),
    params=signed_distances.PoseParams,
    reads=("touch_depth", "mesh"),
)
ICP = Method(
    stage="pose",
    name="icp",
    title="ICP (Open3D)",
    help="point-to-plane ICP on sampled points, as in the paper",
    run=skip_if_exact(signed_distances.skip_without_contact, signed_distances.estimate_pose_icp),
    params=signed_distances.PoseParams,
    reads=("touch_depth", "mesh"),
)
NETWORK = Method(
    stage="pose",
    name="network",
    title="Network",
    help="the paper's tactile metric: planar pose of trained objects, from the tactile image",
    run=fall_back_without_weights(
        network.predict_pose, network.REGISTRATION_OF_TOUCH, "signed distances: no network for this target"
    ),
    params=signed_distances.PoseParams,
    reads=(*network.READS, "pose_weights"),
    weights=network.select_weights,
)


def _make_preview(pose: ObjectPose, context: PreviewContext) -> Preview:
    """Distance of the registered points to the posed object, over the faded tactile image."""
    depth: DepthMap = context.outputs["touch_depth"]
    values = np.full(depth.camera.shape, np.nan, dtype=np.float32)
    element = np.full(depth.camera.shape, -1, dtype=np.int32)
    at = np.flatnonzero(pose.source_index >= 0)
    scale = make_residual_scale(context.display)
    pixels, caption = _make_faded_background(context, depth), f"no pose: {pose.notes[0]}" if pose.notes else "no pose"
    element.flat[pose.source_index[at]] = at
    if pose.sensor_from_object is not None and context.mesh is not None and at.size:
        in_object = rigid.apply(rigid.invert(pose.sensor_from_object), pose.scene_mm[at])
        values.flat[pose.source_index[at]] = load_distance_grid(context.mesh).at(in_object)[0]
        shown = _dilate_points(values, len(pose.scene_mm), depth.contact)
        pixels = np.where(np.isfinite(shown)[..., None], apply_colour_map(shown, scale), pixels)
        share = f"{100 * pose.fitness:.0f} % of {at.size} points"
        caption = f"distance to object, + outside; rms {pose.rmse_mm:.2f} mm, {share}"
    return Preview(
        pixels=freeze(np.ascontiguousarray(pixels, dtype=np.uint8)), values=freeze(values), scale=scale,
        frame_name=f"{context.target.name} frame", positions_mm=PixelPositions(depth.camera, depth.depth_mm),
        outline_px=trace_outline(depth.contact), pixel_mm=compute_pixel_mm(depth.camera, context.target),
        caption=caption,
        element_index=freeze(element), camera=depth.camera,
    )  # fmt: skip


def make_residual_scale(display: DisplayParams) -> ColourScale:
    """Colour scale of the distance to the posed object."""
    limit, setting = display.residual_limit_mm, "residual_limit_mm"
    return ColourScale(
        colour_map="diverging", low=-limit, high=limit, unit="mm", quantity="distance to object, + outside it",
        low_setting=setting,
        high_setting=setting, is_subtractable=False,
    )  # fmt: skip


def _make_layers(pose: ObjectPose, context: PreviewContext, _make_preview: Preview) -> tuple[Layer, ...]:
    """Registered points, posed object and rest surface."""
    scene = make_cloud_layer("scene", pose.scene_mm, repeat_colour(REGISTERED_POINT_COLOUR, len(pose.scene_mm)), 4.0)
    layers = (scene, make_membrane_layer(context.target))
    if context.mesh is None or pose.sensor_from_object is None:
        return layers
    return (*layers, make_object_layer(context.mesh, pose.sensor_from_object))


def _make_step_layers(pose: ObjectPose, context: PreviewContext, preview: Preview) -> tuple[Layer, ...]:
    """The object at one step, with a line from each registered point to its nearest surface point."""
    if context.mesh is None or pose.sensor_from_object is None:
        return _make_layers(pose, context, preview)
    correspondences = step_history.compute_correspondences(pose, load_distance_grid(context.mesh))
    scale = make_residual_scale(context.display)
    colours = np.where(
        correspondences.is_inlier[:, None],
        apply_colour_map(correspondences.distance_mm.astype(np.float32), scale),
        UNMATCHED_POINT_COLOUR,
    )
    every = slice(None, None, max(1, math.ceil(len(colours) / _MAX_LINES)))
    ends = np.stack([pose.scene_mm, correspondences.nearest_mm.astype(np.float32)], axis=1)
    return (
        make_cloud_layer("scene", pose.scene_mm, colours.astype(np.uint8), 4.0, scale.colour_map),
        make_lines_layer("correspondences", ends[every], colours[every].astype(np.uint8), scale.colour_map),
        *_make_layers(pose, context, preview)[1:],
    )


def _trace_point(pose: ObjectPose, before: ProbePoint) -> ProbePoint:
    point = look_up_element(pose.source_index, before.index)
    if point < 0:
        return ProbePoint(
            stage="pose", index=-1, row=before.row, col=before.col, text="not among the registered points"
        )
    x, y, z = to_xyz(pose.scene_mm[point])
    text = f"registered at ({x:.2f}, {y:.2f}, {z:.2f}) mm"
    return ProbePoint(stage="pose", index=point, row=before.row, col=before.col, point_mm=(x, y, z), text=text)


def _compute_metrics(pose: ObjectPose, facts: GroundTruth) -> Mapping[str, float]:
    return (
        {} if facts.target_truth is None else compute_pose_metrics(pose, facts.target_truth, facts.mesh, facts.symmetry)
    )


def _make_faded_background(context: PreviewContext, touch_depth: DepthMap) -> Image:
    touch = context.outputs.get("touch")
    if touch is None or touch.image.ndim == 2:
        return np.full((*touch_depth.camera.shape, 3), NO_VALUE_COLOUR, dtype=np.uint8)
    grey = touch.image.mean(axis=-1, keepdims=True)
    return np.broadcast_to(150.0 + 0.4 * grey, touch.image.shape).astype(np.uint8)


def _dilate_points(values: Floats, n_points: int, contact: Mask) -> Floats:
    """Points dilated to the area they stand for, so that sparse points are visible."""
    import cv2

    side = max(3, min(9, 2 * round(0.5 * math.sqrt(max(1, int(contact.sum())) / max(1, n_points))) + 1))
    kernel = np.ones((side, side), dtype=np.uint8)
    high = cv2.dilate(np.where(np.isfinite(values), values, -1e3).astype(np.float32), kernel)
    return np.where(high > -1e2, high, np.nan).astype(np.float32)


STAGE = Stage(
    name="pose",
    title="Object pose",
    legend="registered points, object, target at rest",
    sensor_role="target",
    methods=(SIGNED_DISTANCES, PAPER_2D, ICP, NETWORK),
    make_preview=_make_preview,
    make_layers=_make_layers,
    trace_point=_trace_point,
    compute_metrics=_compute_metrics,
    make_ground_truth=ground_truth.build_pose,
    preview_stages=("touch", "touch_depth"),
    exaggerates_indentation=False,
    has_steps=True,
    split_steps=step_history.split_steps,
    make_step_layers=_make_step_layers,
    summarise_steps=step_history.summarise_steps,
)
