"""The slot *cloud*: the contact as points in the target's frame."""

from __future__ import annotations

import numpy as np

from pipeline.base.arrays import Indices, freeze
from pipeline.engine.graph import Method, unless
from pipeline.geometry.camera import Camera
from pipeline.pictures.colours import ColourScale, coloured
from pipeline.pictures.layers import Layer, cloud_layer, membrane_layer, stretched
from pipeline.pictures.picture import Picture, pixel_mm
from pipeline.stages.adapt import stage
from pipeline.stages.follow import element_of, triple
from pipeline.stages.slot import Mark, Seen, Slot
from pipeline.values.results import Cloud

PICTURE_SHARE = 0.5  # a cloud is drawn on the target's pixels at half density, where neighbours close up

BACK_PROJECTION = Method(
    slot="cloud",
    name="back_projection",
    title="Back-projection",
    help="every contact pixel as a point (paper, eq. P_T)",
    run=unless(stage.without_contact, stage.adapt),
    params=stage.AdaptParams,
    reads=("depth", "alignment"),
    version=3,
)


def _picture(cloud: Cloud, seen: Seen) -> Picture:
    """The points where the target's camera would see them, coloured by how far they reach past its rest surface."""
    target = seen.target
    camera = target.camera.scaled(PICTURE_SHARE)
    index = _splat(cloud, camera)
    there = index >= 0
    reach = np.full(camera.shape, np.nan, dtype=np.float32)
    places = np.full((*camera.shape, 3), np.nan, dtype=np.float32)
    if len(cloud.points_mm):
        reach[there] = -target.membrane.signed_distance_mm(cloud.points_mm[index[there]])
        places[there] = cloud.points_mm[index[there]]
    scale = _scale(seen)
    return Picture(
        pixels=coloured(reach, scale), values=freeze(reach), scale=scale, frame_name=f"{target.name} frame",
        positions_mm=freeze(places), pixel_mm=pixel_mm(camera, target), element=index, camera=camera,
        caption=f"{len(cloud.points_mm)} points; past rest surface, + toward camera",
    )  # fmt: skip


def _layers(cloud: Cloud, seen: Seen, _picture: Picture) -> tuple[Layer, ...]:
    """The points over the target's faint rest surface."""
    points = stretched(cloud.points_mm, seen.target, seen.display.stretch(seen.target))
    reach = -seen.target.membrane.signed_distance_mm(cloud.points_mm).astype(np.float32)
    layer = cloud_layer("cloud", points.astype(np.float32), coloured(reach, _scale(seen)), 3.0)
    return (layer, membrane_layer(seen.target))


def _follow(cloud: Cloud, before: Mark) -> Mark:
    point = element_of(cloud.source_index, before.index)
    if point < 0:
        why = "thinned out of the cloud" if cloud.stride > 1 else "not carried over"
        return Mark(slot="cloud", index=-1, text=why)
    x, y, z = triple(cloud.points_mm[point])
    return Mark(slot="cloud", index=point, point_mm=(x, y, z), text=f"({x:.2f}, {y:.2f}, {z:.2f}) mm")


def _scale(seen: Seen) -> ColourScale:
    limit, sets = seen.display.limit_mm(seen.target), f"{seen.target.kind}_limit_mm"
    return ColourScale(
        map="diverging", low=-limit, high=limit, unit="mm", quantity="past rest surface, + toward camera",
        sets_low=sets, sets_high=sets,
    )  # fmt: skip


def _splat(cloud: Cloud, camera: Camera) -> Indices:
    index = np.full(camera.shape, -1, dtype=np.int32)
    if len(cloud.points_mm):
        x_px, y_px, visible = camera.project(cloud.points_mm)
        rows, cols = np.rint(y_px[visible]).astype(np.intp), np.rint(x_px[visible]).astype(np.intp)
        which = np.flatnonzero(visible)
        nearest_last = np.argsort(-cloud.points_mm[which, 2], kind="stable")  # so that the nearest wins its pixel
        index[rows[nearest_last], cols[nearest_last]] = which[nearest_last]
    return freeze(index)


SLOT = Slot(
    name="cloud",
    title="Adapted cloud",
    legend="points, target at rest",
    place="target",
    methods=(BACK_PROJECTION,),
    picture=_picture,
    layers=_layers,
    follow=_follow,
)
