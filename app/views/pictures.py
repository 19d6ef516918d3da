"""What each stage's column shows in 2D. Made in the background: the window only hands finished pixels to the screen."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from app.session.state import DisplayParams
from app.work.residuals import ObjectSurface
from pipeline.base.arrays import Floats, Image, Mask, freeze
from pipeline.geometry.camera import Camera
from pipeline.sensors.spec import SensorSpec
from pipeline.values.frames import TactileFrame
from pipeline.values.results import Cloud, DepthMap, ObjectPose, TargetView, Touch
from widgets.colours import NO_VALUE, ColourScale, coloured
from widgets.picture import Picture

INDENTATION = "indentation, + toward camera"
RESIDUAL_MM = 0.5  # colour limit of the distance to the posed object
CLOUD_SHARE = 0.5  # a cloud is drawn on the target's pixels at half density, where neighbours close up


@dataclass(frozen=True, slots=True, kw_only=True)
class CloudPicture:
    """The cloud's picture, and which point each of its pixels shows."""

    picture: Picture
    camera: Camera
    point_index: NDArray[np.int32]  # (rows, cols), -1 = none


def of_source(frame: TactileFrame, sensor: SensorSpec) -> Picture:
    """The reading itself: true colours of a gel, distance of a bubble's membrane."""
    camera = _fitted(frame.camera or sensor.camera, frame.image.shape)
    place = f"{sensor.name} frame"
    if frame.is_depth:
        depth = np.asarray(frame.image, dtype=np.float32)
        scale = distance_scale(sensor, frame.reference)
        return Picture(
            pixels=coloured(depth, scale), values=depth, scale=scale, frame_name=place,
            pixel_mm=_pixel_mm(camera, sensor), positions_mm=_positions(camera, depth),
            caption=f"{scale.quantity}, {place}",
        )  # fmt: skip
    return Picture(
        pixels=np.asarray(frame.image, dtype=np.uint8), frame_name=place, pixel_mm=_pixel_mm(camera, sensor),
        caption=f"rgb image, {camera.cols} x {camera.rows} px",
    )  # fmt: skip


def of_depth(depth: DepthMap, sensor: SensorSpec, display: DisplayParams) -> Picture:
    """Indentation with the contact's outline."""
    scale = indentation_scale(sensor, display)
    return Picture(
        pixels=coloured(depth.indentation_mm, scale), values=depth.indentation_mm, scale=scale,
        frame_name=f"{sensor.name} frame", positions_mm=_positions(depth.camera, depth.depth_mm),
        outline_px=outline(depth.contact), pixel_mm=_pixel_mm(depth.camera, sensor), caption=INDENTATION,
    )  # fmt: skip


def of_cloud(cloud: Cloud, target: SensorSpec, display: DisplayParams) -> CloudPicture:
    """The points where the target's camera would see them, coloured by how far they reach past its rest surface."""
    camera = target.camera.scaled(CLOUD_SHARE)
    index = _splat(cloud.points_mm, camera)
    there = index >= 0
    reach = np.full(camera.shape, np.nan, dtype=np.float32)
    places = np.full((*camera.shape, 3), np.nan, dtype=np.float32)
    if len(cloud.points_mm):
        distance = -target.membrane.signed_distance_mm(cloud.points_mm)
        reach[there] = distance[index[there]]
        places[there] = cloud.points_mm[index[there]]
    limit = limit_mm(target, display)
    scale = ColourScale(map="CET-D1", low=-limit, high=limit, unit="mm", quantity="past rest surface, + toward camera")
    picture = Picture(
        pixels=coloured(reach, scale), values=freeze(reach), scale=scale, frame_name=f"{target.name} frame",
        positions_mm=freeze(places), pixel_mm=_pixel_mm(camera, target),
        caption=f"{len(cloud.points_mm)} points; past rest surface, + toward camera",
    )  # fmt: skip
    return CloudPicture(picture=picture, camera=camera, point_index=index)


def of_view(view: TargetView, target: SensorSpec, display: DisplayParams) -> Picture:
    """Target depth as indentation where there is a surface, with the mask's outline."""
    scale = indentation_scale(target, display)
    rest = _rest_mm(target, view.camera)
    shown = freeze(np.asarray(rest - view.depth_mm, dtype=np.float32))
    return Picture(
        pixels=coloured(shown, scale), values=shown, scale=scale, frame_name=f"{target.name} frame",
        positions_mm=_positions(view.camera, view.depth_mm), outline_px=outline(view.contact),
        pixel_mm=_pixel_mm(view.camera, target), caption=f"{INDENTATION}; mask outlined",
    )  # fmt: skip


def beside(picture: Picture, felt_px: Floats | None) -> Picture:
    """A view with the border of what the target really felt."""
    if felt_px is None:
        return picture
    return replace(picture, felt_px=felt_px, caption=f"{INDENTATION}; orange: mask, white: felt")


def enlarged(picture: Picture, shape: tuple[int, int]) -> Picture:
    """A coarse picture on as many pixels as the full one has, so that the view stays where it is."""
    rows, cols = shape
    old_rows, old_cols = picture.pixels.shape[:2]
    if (old_rows, old_cols) == shape:
        return picture

    def grown(values: Any) -> Any:
        return freeze(cv2.resize(values, (cols, rows), interpolation=cv2.INTER_NEAREST))

    times = np.array([cols / old_cols, rows / old_rows], dtype=np.float32)
    return replace(
        picture, pixels=grown(picture.pixels), pixel_mm=picture.pixel_mm / float(times[0]),
        values=None if picture.values is None else grown(picture.values),
        positions_mm=None if picture.positions_mm is None else grown(picture.positions_mm),
        outline_px=None if picture.outline_px is None else freeze(picture.outline_px * times),
    )  # fmt: skip


def of_touch(touch: Touch, target: SensorSpec) -> Picture:
    """What the target would have recorded."""
    place = f"{target.name} frame"
    positions, pixel_mm = _positions(touch.camera, touch.depth_mm), _pixel_mm(touch.camera, target)
    border = outline(touch.contact)
    if touch.image.ndim == 2:
        image = np.asarray(touch.image, dtype=np.float32)
        scale = distance_scale(target)
        return Picture(
            pixels=coloured(image, scale), values=image, scale=scale, frame_name=place, positions_mm=positions,
            outline_px=border, pixel_mm=pixel_mm, caption=f"{scale.quantity}, {place}",
        )  # fmt: skip
    return Picture(
        pixels=np.asarray(touch.image, dtype=np.uint8), frame_name=place, positions_mm=positions, outline_px=border,
        pixel_mm=pixel_mm, caption=f"rgb image, {touch.camera.cols} x {touch.camera.rows} px",
    )  # fmt: skip


def of_pose(pose: ObjectPose, touch: Touch, target: SensorSpec, surface: ObjectSurface | None) -> Picture:
    """How far the registered points lie from the posed object, over the faded touch."""
    rows, cols = touch.camera.shape
    pixels = _faded(touch, rows, cols)
    values = np.full((rows, cols), np.nan, dtype=np.float32)
    at = pose.source_index
    seen = at >= 0
    scale = ColourScale(
        map="CET-D1", low=-RESIDUAL_MM, high=RESIDUAL_MM, unit="mm", quantity="distance to object, + outside it"
    )
    caption = f"no pose: {pose.notes[0]}" if pose.notes else "no pose"
    if pose.sensor_from_object is not None and surface is not None and seen.any():
        values.flat[at[seen]] = surface.distances_mm(pose.scene_mm[seen], pose.sensor_from_object)
        known = np.isfinite(values)
        spread = _spread(values, len(pose.scene_mm), int(touch.contact.sum()))
        pixels = np.where(np.isfinite(spread)[..., None], coloured(spread, scale), pixels)
        share = f"{100 * pose.fitness:.0f} % of {int(known.sum())} points"
        caption = f"distance to object, + outside; rms {pose.rmse_mm:.2f} mm, {share}"
    return Picture(
        pixels=freeze(np.ascontiguousarray(pixels, dtype=np.uint8)), values=freeze(values), scale=scale,
        frame_name=f"{target.name} frame", positions_mm=_positions(touch.camera, touch.depth_mm),
        outline_px=outline(touch.contact), pixel_mm=_pixel_mm(touch.camera, target), caption=caption,
    )  # fmt: skip


def limit_mm(sensor: SensorSpec, display: DisplayParams) -> float:
    """Upper colour limit of indentations of this kind of sensor."""
    return display.gel_limit_mm if sensor.kind == "gel" else display.bubble_limit_mm


def indentation_scale(sensor: SensorSpec, display: DisplayParams) -> ColourScale:
    """The fixed scale of indentations of this kind of sensor."""
    return ColourScale(map="viridis", low=0.0, high=limit_mm(sensor, display), unit="mm", quantity=INDENTATION)


def distance_scale(sensor: SensorSpec, reference: NDArray[np.generic] | None = None) -> ColourScale:
    """The fixed scale of distances that a bubble's camera can see, wider where the recorded unit is built longer."""
    low = 10.0 * math.floor((float(sensor.rest_depth_mm.min()) - 10.0) / 10.0)
    farthest = float(sensor.rest_depth_mm.max())
    if reference is not None and np.isfinite(reference).any():
        farthest = max(farthest, float(np.nanpercentile(reference.astype(np.float64), 99.0)))
    high = 10.0 * math.ceil(farthest / 10.0)
    return ColourScale(map="viridis", low=low, high=high, unit="mm", quantity="distance z from camera")


def outline(mask: Mask) -> Floats:
    """Border of a mask as x, y (n, 2) in picture coordinates, NaN between its pieces."""
    pieces, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    gap = np.full((1, 2), np.nan, dtype=np.float32)
    parts: list[NDArray[np.float32]] = []
    for piece in pieces:
        if len(piece) < 6:
            continue
        line = piece[:, 0, :].astype(np.float32) + 0.5
        parts += [line, line[:1], gap]
    return freeze(np.concatenate(parts)) if parts else freeze(np.zeros((0, 2), dtype=np.float32))


def _splat(points_mm: Floats, camera: Camera) -> NDArray[np.int32]:
    index = np.full(camera.shape, -1, dtype=np.int32)
    if not len(points_mm):
        return index
    x_px, y_px, visible = camera.project(points_mm)
    rows, cols = np.rint(y_px[visible]).astype(np.intp), np.rint(x_px[visible]).astype(np.intp)
    which = np.flatnonzero(visible)
    nearest_last = np.argsort(-points_mm[which, 2], kind="stable")  # so that the nearest point wins its pixel
    index[rows[nearest_last], cols[nearest_last]] = which[nearest_last]
    return index


def _spread(values: Floats, n_points: int, n_contact: int) -> Floats:
    """Each point grown to the area it stands for, so that thinned points show on a small picture."""
    side = max(3, min(9, 2 * round(0.5 * math.sqrt(max(1, n_contact) / max(1, n_points))) + 1))
    known = np.isfinite(values)
    kernel = np.ones((side, side), dtype=np.uint8)
    high = cv2.dilate(np.where(known, values, -1e3).astype(np.float32), kernel)
    return np.where(high > -1e2, high, np.nan).astype(np.float32)


def _faded(touch: Touch, rows: int, cols: int) -> Image:
    if touch.image.ndim == 2:
        return np.full((rows, cols, 3), NO_VALUE, dtype=np.uint8)
    grey = touch.image.mean(axis=-1, keepdims=True)
    return np.broadcast_to(150.0 + 0.4 * grey, (rows, cols, 3)).astype(np.uint8)


def _positions(camera: Camera, depth_mm: Floats) -> Floats:
    return freeze(camera.back_project(depth_mm).astype(np.float32))


def _pixel_mm(camera: Camera, sensor: SensorSpec) -> float:
    return float(np.median(sensor.rest_depth_mm) / camera.fx_px)


def _rest_mm(sensor: SensorSpec, camera: Camera) -> NDArray[np.float64]:
    return sensor.rest_depth_mm if camera == sensor.camera else sensor.membrane.rest_depth_mm(camera)


def _fitted(camera: Camera, shape: tuple[int, ...]) -> Camera:
    """The camera, brought to the size of an image that was taken at another resolution."""
    return camera if camera.shape == shape[:2] else camera.scaled(shape[1] / camera.cols)
