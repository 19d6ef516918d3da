"""Input of the T2T networks: the change of the source frame, resampled to the target's view.

Source and target see one plane, the gel's surface at rest: the object is there when both are in
contact. A gel's difference image is sampled finer than the target's pixels and folded into
channels, so that edges finer than a bubble's pixels are preserved.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.core.arrays import Doubles, Floats, Mask, freeze
from pipeline.core.derived import derive_once
from pipeline.core.geometry import rigid
from pipeline.core.geometry.camera import MIN_DEPTH_MM, Camera
from pipeline.sensors.alignment import Alignment
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.networks.touch_formats import normalise

_OVERLAP_UNIT_MM = np.float32(6.0)
_RELIEF_UNIT_MM = np.float32(1.0)
# of a bubble's relief: smoothing; percentile that is its top
_SMOOTHING_PX = 1.2
_TOP_PERCENTILE = 99.5
_MAX_HEIGHT_MM = np.float32(3.0)  # of a bubble's surface above a gel's
_UPSAMPLING = 2  # samples per pixel of the target's working grid, in each direction
_CHANGE_UNIT_GREY = np.float32(48.0)
# of `build_image_condition`: three colours, the view, and how far the sensors overlap
IMAGE_CHANNELS = 3 * _UPSAMPLING**2 + 2
_SOURCE_PX_MM = 0.085  # a gel's image is averaged to about this pixel size before resampling


def build_image_condition(
    image_change: NDArray[Any],
    source_camera: Camera,
    source: SensorSpec,
    target: SensorSpec,
    alignment: Alignment,
) -> Floats:
    """(IMAGE_CHANNELS, rows, cols) on the camera grid of `target`, the working grid.

    `image_change` is frame minus reference of a gel's `source_camera`: (rows, cols, 3) in grey
    levels.
    """
    sampling_map = _compute_sampling_map(source, source_camera, target, alignment, _UPSAMPLING)
    resampled = _resample(np.asarray(image_change, np.float32), sampling_map) / _CHANGE_UNIT_GREY
    channels = [
        _fold_pixels(np.ascontiguousarray(c), _UPSAMPLING) for c in np.moveaxis(resampled, -1, 0)
    ]
    in_view = sampling_map.inside[::_UPSAMPLING, ::_UPSAMPLING].astype(np.float32)
    overlap_mm = _compute_overlap_mm(source, target, alignment, sampling_map)
    placement = np.stack([in_view, overlap_mm / _OVERLAP_UNIT_MM])
    return freeze(np.concatenate([*channels, placement]).astype(np.float32))


def reproject_square(
    square_change: Floats, source: SensorSpec, target: SensorSpec, alignment: Alignment
) -> Floats:
    """(channels, side, side), normalised: a square of the source's change, resampled to a square of
    the target's view.

    Both as in `touch_formats.resize_to_square`. A gel's change is 0 outside the view; of a bubble
    it is the relief that a gel feels, see `_compute_relief`.
    """
    side = square_change.shape[-1]
    source_camera = source.camera.resize(side, side)
    target_square = target.with_camera(target.camera.resize(side, side))
    sampling_map = _compute_sampling_map(source, source_camera, target_square, alignment, 1)
    if source.sensor_kind.is_depth:
        return freeze(_compute_relief(square_change[0], sampling_map)[None].astype(np.float32))
    resampled = _resample(
        np.ascontiguousarray(normalise(square_change, source.kind).transpose(1, 2, 0)), sampling_map
    )
    return freeze(np.ascontiguousarray(resampled.transpose(2, 0, 1)))


def build_reprojected_square(
    square_change: Floats, source: SensorSpec, target: SensorSpec, alignment: Alignment
) -> Floats:
    """(reprojected channels, side, side): what `reproject_square` gives, how sensors overlap, and
    the source's view.

    Sensors overlap by how far the gel's surface at rest lies inside the bubble's. A gel's change
    comes with the overlap; a bubble's relief comes with the height of its surface above the gel's.
    """
    side = square_change.shape[-1]
    source_square, target_square = (
        one.with_camera(one.camera.resize(side, side)) for one in (source, target)
    )
    sampling_map = _compute_sampling_map(source, source_square.camera, target_square, alignment, 1)
    change = reproject_square(square_change, source, target, alignment)
    overlap_mm = _compute_overlap_mm(source_square, target_square, alignment, sampling_map)
    inside = sampling_map.inside.astype(np.float32)
    if not source.sensor_kind.is_depth:
        return freeze(np.concatenate([change, (overlap_mm / _OVERLAP_UNIT_MM)[None], inside[None]]))
    height_mm = _resample(_smooth(square_change[0]), sampling_map) - overlap_mm
    height = np.clip(
        np.where(sampling_map.inside, height_mm, -_MAX_HEIGHT_MM), -_MAX_HEIGHT_MM, _MAX_HEIGHT_MM
    )
    return freeze(np.concatenate([height[None], change, inside[None]]).astype(np.float32))


def _compute_overlap_mm(
    source: SensorSpec, target: SensorSpec, alignment: Alignment, sampling_map: _SamplingMap
) -> Floats:
    """(rows, cols) of the target: how far the gel's surface at rest lies inside the bubble's
    surface at rest.
    """
    points = _find_rest_plane(source, target, target.camera, alignment)
    if target.sensor_kind.is_depth:
        plane_z_mm = rigid.apply(alignment.target_from_source, points)[:, 2].reshape(
            target.camera.shape
        )
        return (target.rest_depth_mm - plane_z_mm).astype(np.float32)
    rest_mm = _resample(source.rest_depth_mm.astype(np.float32), sampling_map)
    return (rest_mm - points[:, 2].reshape(target.camera.shape)).astype(np.float32)


@dataclass(frozen=True, slots=True)
class _SamplingMap:
    """Source pixel of every fine target pixel; the source is first averaged to `size`."""

    x: Floats
    y: Floats
    inside: Mask
    size: tuple[int, int] | None  # (cols, rows) px; None = full size


def _compute_relief(change: Floats, sampling_map: _SamplingMap) -> Floats:
    """Distance of a smoothed bubble behind its top within the target's view, which is what a gel
    would feel.
    """
    resampled = _resample(_smooth(change), sampling_map)
    inside = sampling_map.inside
    top = (
        np.float32(np.percentile(resampled[inside], _TOP_PERCENTILE))
        if inside.any()
        else np.float32(0.0)
    )
    return np.where(
        inside, np.clip((resampled - top) / _RELIEF_UNIT_MM, -3.0, 1.0), np.float32(-3.0)
    )


def _smooth(field: Floats) -> Floats:
    import cv2

    return np.asarray(cv2.GaussianBlur(field, (0, 0), _SMOOTHING_PX), np.float32)


def _resample(field: Floats, sampling_map: _SamplingMap) -> Floats:
    import cv2

    if sampling_map.size is not None:
        field = np.asarray(
            cv2.resize(field, sampling_map.size, interpolation=cv2.INTER_AREA), np.float32
        )
    found = cv2.remap(
        field, sampling_map.x, sampling_map.y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    shown = sampling_map.inside if found.ndim == 2 else sampling_map.inside[..., None]
    return np.where(shown, np.asarray(found, np.float32), np.float32(0.0))


@derive_once
def _compute_sampling_map(
    source: SensorSpec,
    source_camera: Camera,
    target: SensorSpec,
    alignment: Alignment,
    upsampling: int,
) -> _SamplingMap:
    x, y, inside = _project_to_source(source, source_camera, target, alignment, upsampling)
    scale = (
        min(1.0, source.with_camera(source_camera).pixel_mm / _SOURCE_PX_MM)
        if not source.sensor_kind.is_depth
        else 1.0
    )
    size = (
        None
        if scale == 1.0
        else (max(8, round(source_camera.cols * scale)), max(8, round(source_camera.rows * scale)))
    )
    sx, sy = (
        (1.0, 1.0) if size is None else (size[0] / source_camera.cols, size[1] / source_camera.rows)
    )
    at_x = ((x + 0.5) * sx - 0.5).astype(np.float32)
    at_y = ((y + 0.5) * sy - 0.5).astype(np.float32)
    return _SamplingMap(freeze(at_x), freeze(at_y), freeze(inside), size)


def _project_to_source(
    source: SensorSpec,
    source_camera: Camera,
    target: SensorSpec,
    alignment: Alignment,
    upsampling: int,
) -> tuple[Doubles, Doubles, Mask]:
    """(x, y) in px of the source image for every fine target pixel, and whether it lies inside."""
    camera = target.camera.scale(float(upsampling))
    points = _find_rest_plane(source, target, camera, alignment)
    with np.errstate(divide="ignore", invalid="ignore"):
        x = source_camera.fx_px * points[:, 0] / points[:, 2] + source_camera.cx_px
        y = source_camera.fy_px * points[:, 1] / points[:, 2] + source_camera.cy_px
        inside = (
            (points[:, 2] > MIN_DEPTH_MM)
            & (x >= -0.5)
            & (x < source_camera.cols - 0.5)
            & (y >= -0.5)
            & (y < source_camera.rows - 0.5)
        )
    return (
        np.where(inside, x, 0.0).reshape(camera.shape),
        np.where(inside, y, 0.0).reshape(camera.shape),
        inside.reshape(camera.shape),
    )


def _find_rest_plane(
    source: SensorSpec, target: SensorSpec, camera: Camera, alignment: Alignment
) -> Doubles:
    """(pixels, 3): where pixels of the target's `camera` meet the gel's surface at rest, in the
    source's frame.
    """
    from_target = rigid.invert(
        rigid.validate_rigid(alignment.target_from_source, "the alignment T_S->T")
    )
    if not target.sensor_kind.is_depth:
        rest_mm = float(np.median(target.rest_depth_mm))
        return rigid.apply(
            from_target, camera.back_project(np.full(camera.shape, rest_mm)).reshape(-1, 3)
        )
    origin = from_target[:3, 3]
    directions = camera.back_project(np.ones(camera.shape)).reshape(-1, 3) @ from_target[:3, :3].T
    rest_mm = float(np.median(source.rest_depth_mm))
    with np.errstate(divide="ignore", invalid="ignore"):
        return origin + directions * ((rest_mm - origin[2]) / directions[:, 2])[:, None]


def _fold_pixels(fine: Floats, upsampling: int) -> Floats:
    """(upsampling^2, rows, cols): the fine pixels of each pixel as channels."""
    rows, cols = (n // upsampling for n in fine.shape)
    parts = fine[: rows * upsampling, : cols * upsampling].reshape(
        rows, upsampling, cols, upsampling
    )
    return parts.transpose(1, 3, 0, 2).reshape(upsampling * upsampling, rows, cols)
