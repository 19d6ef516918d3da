"""The slot *pose*: where the touched object is, in the target's frame."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from pipeline.base.arrays import Floats, Image, Mask, freeze
from pipeline.engine.graph import Method, unless
from pipeline.evaluation.metrics import pose_figures
from pipeline.geometry import rigid
from pipeline.geometry.distance_grid_store import distance_grid
from pipeline.pictures.colours import NO_PARTNER, NO_VALUE, SCENE, ColourScale, coloured, uniform
from pipeline.pictures.display import DisplayParams
from pipeline.pictures.layers import Layer, cloud_layer, lines_layer, membrane_layer, object_layer
from pipeline.pictures.picture import Laid, Picture, outline, pixel_mm
from pipeline.stages import known_truth
from pipeline.stages.follow import element_of, triple
from pipeline.stages.learned import learned
from pipeline.stages.pose import network, stage, way
from pipeline.stages.slot import Facts, Mark, Seen, Slot
from pipeline.values.results import DepthMap, ObjectPose

_MOST_LINES = 400  # from registered points to the object: more would hide it

SIGNED_DISTANCES = Method(
    slot="pose",
    name="signed_distances",
    title="Signed distances",
    help="many starts, registered on the mesh's signed distances, judged by felt and unfelt space",
    run=unless(stage.nothing_to_pose, stage.posed),
    params=stage.PoseParams,
    reads=("felt", "mesh", "previous"),
    version=5,
)
PAPER_2D = Method(
    slot="pose",
    name="paper_2d",
    title="Paper, 2D",
    help="the paper's released evaluation: in-plane turn and shift of projections",
    run=unless(stage.without_contact, stage.planar),
    params=stage.PoseParams,
    reads=("felt", "mesh"),
)
ICP = Method(
    slot="pose",
    name="icp",
    title="ICP (Open3D)",
    help="point-to-plane ICP on sampled points, the paper's own way",
    run=unless(stage.without_contact, stage.icp),
    params=stage.PoseParams,
    reads=("felt", "mesh"),
)
NETWORK = Method(
    slot="pose",
    name="network",
    title="Network",
    help="the paper's tactile metric: shift and turn of objects that it was taught, from the touch's picture",
    run=learned(network.pose, instead=network.REGISTRATION),
    params=stage.PoseParams,
    reads=(*network.READS, "pose_weights"),
    weights=network.weights,
)


def _picture(pose: ObjectPose, seen: Seen) -> Picture:
    """How far the registered points lie from the posed object, over the faded touch."""
    felt: DepthMap = seen.outputs["felt"]
    values = np.full(felt.camera.shape, np.nan, dtype=np.float32)
    element = np.full(felt.camera.shape, -1, dtype=np.int32)
    at = np.flatnonzero(pose.source_index >= 0)
    scale = residual_scale(seen.display)
    pixels, caption = _faded(seen, felt), f"no pose: {pose.notes[0]}" if pose.notes else "no pose"
    element.flat[pose.source_index[at]] = at
    if pose.sensor_from_object is not None and seen.mesh is not None and at.size:
        in_object = rigid.apply(rigid.invert(pose.sensor_from_object), pose.scene_mm[at])
        values.flat[pose.source_index[at]] = distance_grid(seen.mesh).at(in_object)[0]
        shown = _grown(values, len(pose.scene_mm), felt.contact)
        pixels = np.where(np.isfinite(shown)[..., None], coloured(shown, scale), pixels)
        share = f"{100 * pose.fitness:.0f} % of {at.size} points"
        caption = f"distance to object, + outside; rms {pose.rmse_mm:.2f} mm, {share}"
    return Picture(
        pixels=freeze(np.ascontiguousarray(pixels, dtype=np.uint8)), values=freeze(values), scale=scale,
        frame_name=f"{seen.target.name} frame", positions_mm=Laid(felt.camera, felt.depth_mm),
        outline_px=outline(felt.contact), pixel_mm=pixel_mm(felt.camera, seen.target), caption=caption,
        element=freeze(element), camera=felt.camera,
    )  # fmt: skip


def residual_scale(display: DisplayParams) -> ColourScale:
    """Of the distance to the posed object."""
    limit, sets = display.residual_limit_mm, "residual_limit_mm"
    return ColourScale(
        map="diverging", low=-limit, high=limit, unit="mm", quantity="distance to object, + outside it", sets_low=sets,
        sets_high=sets, subtracts=False,
    )  # fmt: skip


def _layers(pose: ObjectPose, seen: Seen, _picture: Picture) -> tuple[Layer, ...]:
    """The registered points, the object where it was found, and the rest surface."""
    scene = cloud_layer("scene", pose.scene_mm, uniform(SCENE, len(pose.scene_mm)), 4.0)
    layers = (scene, membrane_layer(seen.target))
    if seen.mesh is None or pose.sensor_from_object is None:
        return layers
    return (*layers, object_layer(seen.mesh, pose.sensor_from_object))


def _state_layers(pose: ObjectPose, seen: Seen, picture: Picture) -> tuple[Layer, ...]:
    """The object at one step, with a line from each registered point to the nearest of its surface."""
    if seen.mesh is None or pose.sensor_from_object is None:
        return _layers(pose, seen, picture)
    found = way.partners(pose, distance_grid(seen.mesh))
    colours = np.where(
        found.taken[:, None], coloured(found.distance_mm.astype(np.float32), residual_scale(seen.display)), NO_PARTNER
    )
    every = slice(None, None, max(1, math.ceil(len(colours) / _MOST_LINES)))
    ends = np.stack([pose.scene_mm, found.foot_mm.astype(np.float32)], axis=1)
    return (
        cloud_layer("scene", pose.scene_mm, colours.astype(np.uint8), 4.0),
        lines_layer("partners", ends[every], colours[every].astype(np.uint8)),
        *_layers(pose, seen, picture)[1:],
    )


def _follow(pose: ObjectPose, before: Mark) -> Mark:
    point = element_of(pose.source_index, before.index)
    if point < 0:
        return Mark(slot="pose", index=-1, row=before.row, col=before.col, text="not among the registered points")
    x, y, z = triple(pose.scene_mm[point])
    text = f"registered at ({x:.2f}, {y:.2f}, {z:.2f}) mm"
    return Mark(slot="pose", index=point, row=before.row, col=before.col, point_mm=(x, y, z), text=text)


def _figures(pose: ObjectPose, facts: Facts) -> Mapping[str, float]:
    return {} if facts.target is None else pose_figures(pose, facts.target, facts.mesh, facts.symmetry)


def _faded(seen: Seen, felt: DepthMap) -> Image:
    touch = seen.outputs.get("touch")
    if touch is None or touch.image.ndim == 2:
        return np.full((*felt.camera.shape, 3), NO_VALUE, dtype=np.uint8)
    grey = touch.image.mean(axis=-1, keepdims=True)
    return np.broadcast_to(150.0 + 0.4 * grey, touch.image.shape).astype(np.uint8)


def _grown(values: Floats, n_points: int, contact: Mask) -> Floats:
    """Each point grown to the area it stands for, so that thinned points show on a small picture."""
    import cv2

    side = max(3, min(9, 2 * round(0.5 * math.sqrt(max(1, int(contact.sum())) / max(1, n_points))) + 1))
    kernel = np.ones((side, side), dtype=np.uint8)
    high = cv2.dilate(np.where(np.isfinite(values), values, -1e3).astype(np.float32), kernel)
    return np.where(high > -1e2, high, np.nan).astype(np.float32)


SLOT = Slot(
    name="pose",
    title="Object pose",
    legend="registered points, object, target at rest",
    place="target",
    methods=(SIGNED_DISTANCES, PAPER_2D, ICP, NETWORK),
    picture=_picture,
    layers=_layers,
    follow=_follow,
    figures=_figures,
    truth=known_truth.pose,
    looks_at=("touch", "felt"),
    stretches=False,
    scrubs=True,
    states=way.states,
    state_layers=_state_layers,
    way=way.way,
)
